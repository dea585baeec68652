"""A headless Chromium, driven over its debugging pipe: one page, its console, real keys and mouse, pictures."""

import base64
import json
import os
import select
import shutil
import subprocess
import time

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
# Root has no sandbox; a machine without a graphics card draws WebGL in software.
_FLAGS = (
    "--headless=new --no-sandbox --remote-debugging-pipe --no-first-run --disable-extensions --hide-scrollbars "
    "--use-angle=swiftshader --enable-unsafe-swiftshader --disable-dev-shm-usage"
).split()
_KEYS = {" ": ("Space", 32), "ArrowLeft": ("ArrowLeft", 37), "ArrowRight": ("ArrowRight", 39), "End": ("End", 35)}

_READY = "document.documentElement?.dataset.ready || document.getElementById('problem')?.hidden === false"


class Browser:
    """Opens one page after another; `problems` are the errors and warnings that the last one told its console."""

    def __init__(self, home, flags=()):
        ours, theirs = os.pipe(), os.pipe()  # commands and answers, as file descriptors 3 and 4 of the browser
        command = [CHROMIUM, *_FLAGS, *flags, f"--user-data-dir={home}", "about:blank"]
        shell = 'exec "$@" 3<&"$IN" 4>&"$OUT"'
        environment = os.environ | {"IN": str(ours[0]), "OUT": str(theirs[1])}
        self._process = subprocess.Popen(
            ["bash", "-c", shell, "bash", *command],
            env=environment,
            pass_fds=(ours[0], theirs[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(ours[0])
        os.close(theirs[1])
        self._to, self._from, self._buffer, self._number = ours[1], theirs[0], b"", 0
        self._session, self.problems, self.requests = None, [], []
        target = next(t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
        """Send one command of the DevTools protocol and wait for its answer."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def _read(self, seconds=600.0):
        """The next message of the browser; what the page complains about is kept."""
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._from], [], [], seconds)
            assert ready, "the browser says nothing"
            part = os.read(self._from, 1 << 20)
            assert part, "the browser went away"
            self._buffer += part
        text, _, self._buffer = self._buffer.partition(b"\0")
        message = json.loads(text)
        method, told = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.problems.append(told["exceptionDetails"])
        elif (method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning", "assert")) or (
            method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning")
        ):
            self.problems.append(told)
        elif method == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"])
        return message

    def evaluate(self, expression):
        """The value of a JavaScript expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def open(self, path, anchor="", size=(1280, 720), mobile=False, theme="light", ready=_READY):
        """Open a file and wait until it is ready, by default until a flight's page says so."""
        self.problems, self.requests = [], []
        scale = 2 if mobile else 1
        width, height = size
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=mobile
        )
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": theme}])
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=f"file://{path}{anchor}")
        self.wait(ready)

    def wait(self, condition, seconds=600.0):
        """Until a JavaScript condition holds."""
        end = time.monotonic() + seconds
        while not self.evaluate(f"Boolean({condition})"):
            assert time.monotonic() < end, f"waited {seconds:g} s for {condition}"
            time.sleep(0.02)

    def settle(self):
        """Until the page has drawn what it was asked for."""
        self.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")

    def press(self, key, /, **changes):
        """Press and release a key; changes: what the event says otherwise, as an input method or Ctrl makes it."""
        code, number = _KEYS[key]
        event = {"key": key, "code": code, "windowsVirtualKeyCode": number, **changes}
        text = {"text": key} if len(event["key"]) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, **event, **text)
            text = {}
        self.settle()

    def box(self, selector):
        """Left, top, width and height of an element, px."""
        return self.evaluate(
            f"(r => [r.left, r.top, r.width, r.height])(document.querySelector('{selector}').getBoundingClientRect())"
        )

    def drag(self, *places):
        """Press the mouse at the first place (x, y), move through the others, release at the last."""
        self._mouse("mousePressed", places[0])
        for place in places[1:]:
            self._mouse("mouseMoved", place)
        self._mouse("mouseReleased", places[-1])
        self.settle()

    def click(self, selector, x=0.5, y=0.5):
        """Click into an element, at shares of its width and height."""
        left, top, width, height = self.box(selector)
        self.drag((left + x * width, top + y * height))

    def _mouse(self, kind, place):
        x, y = place
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def screenshot(self):
        """What the page shows, PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def close(self):
        try:
            self._session = None
            self.call("Browser.close")
            self._process.wait(600)
        finally:
            self._process.kill()
            self._process.wait()
            os.close(self._to)
            os.close(self._from)
