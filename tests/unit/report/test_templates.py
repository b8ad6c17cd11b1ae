"""Templates are compiled once, and anew where they or Jinja changed."""

import os
import sys

import jinja2

from gnomon.report import page as report_page


def test_code_is_kept_until_the_template_or_jinja_changes(tmp_path, monkeypatch):
    compiled: list[str] = []
    load = report_page.load_template.__wrapped__  # as if each were in a process of its own
    real = jinja2.Environment.compile

    def counted(self, source, *others, **named):
        compiled.append(source)
        return real(self, source, *others, **named)

    monkeypatch.setattr(jinja2.Environment, "compile", counted)
    monkeypatch.setattr(report_page, "_HERE", tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "pycache_prefix", None)
    page = tmp_path / "page.html.jinja"
    page.write_text("Dear {{ name }},", encoding="utf-8")
    (tmp_path / "other.html.jinja").write_text("{% include 'page.html.jinja' %} yes", encoding="utf-8")
    assert load("page.html.jinja").render(name="<you>") == "Dear &lt;you&gt;,"
    assert load("other.html.jinja").render(name="you") == "Dear you, yes"
    assert len(compiled) == 2
    page.write_text("Hello {{ name }},", encoding="utf-8")
    os.utime(page, (1e9, 1e9))
    assert load("other.html.jinja").render(name="you") == "Hello you, yes"
    assert len(compiled) == 3
    monkeypatch.setattr(jinja2, "__version__", "99")
    assert load("page.html.jinja").render(name="you") == "Hello you,"
    assert len(compiled) == 4
