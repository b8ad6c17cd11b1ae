"""The report in a real browser: no script error, no sideways scrolling, figures to be seen, zoom that zooms."""

import json
import os
import shutil
import subprocess

import pytest

from gnomon.report import write_report

fcntl = pytest.importorskip("fcntl", reason="the browser is driven through inherited pipes")

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium, chromium-browser or google-chrome on the PATH"),
]


class Browser:
    """Headless Chromium, driven by its DevTools protocol over a pair of pipes: messages of JSON that end in a zero."""

    def __init__(self, profile):
        flags = (
            "headless", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", "disable-background-networking",
            "disable-component-update", "disable-sync", "disable-extensions", "no-first-run", "remote-debugging-pipe",
            f"user-data-dir={profile}",
        )  # fmt: skip
        commands, self._out = os.pipe()
        self._in, answers = os.pipe()
        # The browser expects its pipes as descriptors 3 and 4; out of their way first.
        inherited = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (commands, answers)]

        def place():
            for end, number in zip(inherited, (3, 4), strict=True):
                os.dup2(end, number)

        self._process = subprocess.Popen(
            [CHROMIUM, *(f"--{flag}" for flag in flags), "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            pass_fds=(3, 4), preexec_fn=place,  # noqa: PLW1509
        )  # fmt: skip
        for end in (commands, answers, *inherited):
            os.close(end)
        self._buffer, self._count, self.session, self.events = b"", 0, None, []
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        self.session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def _message(self):
        while b"\0" not in self._buffer:
            chunk = os.read(self._in, 1 << 20)
            assert chunk, "the browser closed its pipe"
            self._buffer += chunk
        message, self._buffer = self._buffer.split(b"\0", 1)
        return json.loads(message)

    def call(self, method, **params):
        """Send a command and return its result; what else the browser reports meanwhile goes to `events`."""
        self._count += 1
        command = {"id": self._count, "method": method, "params": params}
        if self.session:
            command["sessionId"] = self.session
        os.write(self._out, json.dumps(command).encode() + b"\0")
        while True:
            message = self._message()
            if message.get("id") == self._count:
                assert "error" not in message, message
                return message["result"]
            self.events.append(message)

    def open(self, path, *, width, height, scheme="light", mobile=False, scripts=True):
        """Load a file on a screen of this size (in CSS pixels)."""
        self.events.clear()
        self.call("Emulation.setScriptExecutionDisabled", value=not scripts)
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)
        self.call("Emulation.setTouchEmulationEnabled", enabled=mobile)
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.call("Page.navigate", url=path.as_uri())
        while not any(event["method"] == "Page.loadEventFired" for event in self.events):
            self.events.append(self._message())

    def evaluate(self, expression):
        """Return the value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"]["value"]

    def problems(self):
        """Return what the page complained about: exceptions, errors and warnings of the log, requests to anywhere."""
        bad = [e for e in self.events if e["method"] in ("Runtime.exceptionThrown", "Log.entryAdded")]
        requests = [e["params"]["request"]["url"] for e in self.events if e["method"] == "Network.requestWillBeSent"]
        return bad + [url for url in requests if not url.startswith(("file:", "data:"))]

    def close(self):
        self._process.kill()
        self._process.wait()
        os.close(self._in)
        os.close(self._out)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


MEASURE = """(() => {
  const root = document.documentElement;
  const plots = [...document.querySelectorAll("svg.plot")];
  return {
    inner: window.innerWidth, scroll: root.scrollWidth, client: root.clientWidth,
    plots: plots.map((p) => { const b = p.getBoundingClientRect(); return [b.left, b.right, b.height]; }),
    text: Math.min(...plots.map((p) => p.querySelector("text:not(.fine text)").getBoundingClientRect().height)),
    paper: getComputedStyle(document.body).backgroundColor,
    strokes: [...new Set(plots.flatMap((p) => [...p.querySelectorAll("path")].map((e) => getComputedStyle(e).stroke)))],
    title: document.querySelector("h1").innerText,
  };
})()"""


@pytest.fixture
def report(make_result, tmp_path):
    path = tmp_path / "report.html"
    write_report(make_result(), path)
    return path


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height", "mobile"), [(390, 844, True), (1440, 900, False), (768, 1024, True)])
def test_page_fits_and_is_clean(browser, report, width, height, mobile, scheme):
    browser.open(report, width=width, height=height, mobile=mobile, scheme=scheme)
    seen = browser.evaluate(MEASURE)
    assert browser.problems() == []
    assert seen["inner"] == width
    assert seen["scroll"] <= seen["client"]
    assert seen["title"].startswith("Warn.")
    assert len(seen["plots"]) == 5
    for left, right, tall in seen["plots"]:
        assert left >= 0
        assert right <= width
        assert tall > 100
    assert seen["text"] >= 9
    dark = seen["paper"] == "rgb(18, 23, 28)"
    assert dark == (scheme == "dark")
    # Every placeholder became a colour of the page.
    assert not any("var" in stroke for stroke in seen["strokes"])
    assert len(seen["strokes"]) > 5


@pytest.mark.parametrize("gyroscope", [True, False])
def test_hostile_and_long_names_do_not_break_the_page(browser, make_result, tmp_path, gyroscope):
    names = ("<script>window.broken = 1</script>&\"'", "a" * 200 + ".csv", "<img src=x onerror=window.broken=1>")
    path = tmp_path / "report.html"
    write_report(make_result(names=names, unit='<g id="x">&"', gyroscope=gyroscope, verdict="fail"), path)
    browser.open(path, width=390, height=844, mobile=True)
    seen = browser.evaluate(MEASURE)
    assert browser.problems() == []
    assert seen["scroll"] <= seen["client"]
    assert browser.evaluate("typeof window.broken") == "undefined"
    assert '<g id="x">&"' in browser.evaluate("document.querySelector('svg.plot').textContent")


def test_wheel_zooms_a_clicked_figure_and_double_click_resets(browser, report):
    browser.open(report, width=1440, height=900)
    browser.evaluate("document.documentElement.style.scrollBehavior = 'auto'")
    browser.evaluate("document.querySelector('svg.plot').scrollIntoView({block: 'center'})")
    box = browser.evaluate(
        "(() => { const b = document.querySelector('svg.plot').getBoundingClientRect();"
        " return [b.left + b.width / 4, b.top + b.height / 2]; })()"
    )
    view = "document.querySelector('svg.plot').getAttribute('viewBox').split(' ').map(Number)"
    home = browser.evaluate(view)

    def mouse(kind, x, y, **more):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    mouse("mousePressed", *box, button="left", clickCount=1)
    mouse("mouseReleased", *box, button="left", clickCount=1)
    mouse("mouseWheel", *box, deltaX=0, deltaY=-500)
    zoomed = browser.evaluate(view)
    assert zoomed[2] < 0.6 * home[2]
    # The point under the pointer stays where it is.
    assert zoomed[0] + zoomed[2] / 4 == pytest.approx(home[2] / 4, abs=1)
    mouse("mousePressed", *box, button="left", clickCount=1)
    mouse("mouseMoved", box[0] - 60, box[1], button="left", buttons=1)
    mouse("mouseReleased", box[0] - 60, box[1], button="left", clickCount=1)
    assert browser.evaluate(view)[0] > zoomed[0] + 10
    for count in (1, 2):
        mouse("mousePressed", *box, button="left", clickCount=count)
        mouse("mouseReleased", *box, button="left", clickCount=count)
    assert browser.evaluate(view) == home
    assert browser.problems() == []


def test_everything_can_be_read_without_scripts(browser, report):
    browser.open(report, width=1440, height=900, scripts=False)
    seen = browser.call("Page.captureScreenshot", format="png")
    assert len(seen["data"]) > 10_000
    browser.call("Emulation.setScriptExecutionDisabled", value=False)
    assert browser.evaluate("document.querySelectorAll('svg.plot').length") == 5
    # The script makes figures focusable; here it never ran.
    assert browser.evaluate("document.querySelectorAll('svg.plot[tabindex]').length") == 0
