"""A browser without a window, for tests that look at a page as a person would see it."""

import json
import os
import shutil
import subprocess

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WHY_NOT = "no chromium, chromium-browser or google-chrome on the PATH"

try:
    import fcntl
except ImportError:  # the browser is driven through inherited pipes, which Windows lacks
    CHROMIUM, WHY_NOT = None, "the browser is driven through inherited pipes"


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
        return answer["result"].get("value")  # a call that gives nothing has none

    def on_a_sheet(self):
        """Return how far down a printed sheet of A4 the figures of page one go, 1 at its end; 0 without any."""
        self.call("Emulation.setDeviceMetricsOverride", width=688, height=1032, deviceScaleFactor=1, mobile=False)
        self.call("Emulation.setEmulatedMedia", media="print")  # 96 px an inch, within the margins of page.css
        ends = self.evaluate(
            "[...document.querySelectorAll('.front > figure')].map((f) => f.getBoundingClientRect().bottom + scrollY)"
        )
        self.call("Emulation.setEmulatedMedia", media="")
        return max(ends, default=0) / 1032

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


MEASURE = """(() => {
  const root = document.documentElement;
  document.querySelectorAll("details").forEach((folded) => { folded.open = true; });
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
"""What a test asks of a page of figures."""

CUT_OFF = """(() => [...document.querySelectorAll("svg.plot")].flatMap((plot) => {
  const box = plot.getBoundingClientRect();
  return [...plot.querySelectorAll("text")].filter((text) => {
    const b = text.getBoundingClientRect();
    const aside = Math.max(box.left - b.left, b.right - box.right, box.top - b.top, b.bottom - box.bottom);
    return b.width > 0 && aside > 2;
  }).map((text) => plot.closest("figure").querySelector("h3").innerText + ": " + text.textContent);
}))()"""
"""Texts of figures that lie outside of their figure, where they cannot be read."""
