"""A headless Chromium, driven through its DevTools pipe, to look at pages as a user does."""

import base64
import json
import os
import shutil
import subprocess
import time
from contextlib import suppress

import cv2
import numpy as np

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
# Software rendering, so that WebGL works on machines without a GPU.
FLAGS = [
    *("--headless=new", "--no-sandbox", "--no-first-run", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--remote-debugging-pipe"),
    "--window-size=1400,1100",
]


class Browser:
    """One page of a headless Chromium; use it as a context."""

    def __init__(self, profile):
        self.profile = profile
        self.number = 0
        self.events = []
        self.buffer = b""

    def __enter__(self):
        theirs_in, self.ours_out = os.pipe()
        self.ours_in, theirs_out = os.pipe()
        # Chromium reads descriptor 3 and writes descriptor 4.
        script = f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}'
        command = [CHROMIUM, *FLAGS, f"--user-data-dir={self.profile}", "about:blank"]
        self.process = subprocess.Popen(
            ["bash", "-c", script, "browser", *command],
            pass_fds=(theirs_in, theirs_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self.session = None
        pages = self.call("Target.getTargets")["targetInfos"]
        target = next(t["targetId"] for t in pages if t["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self.session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        return self

    def __exit__(self, *_):
        self.session = None
        with suppress(Exception):
            self.call("Browser.close")
        self.process.terminate()
        self.process.wait(timeout=30)
        os.close(self.ours_out)
        os.close(self.ours_in)

    def call(self, method, **params):
        """Send one command and return its result; events met on the way are kept."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.ours_out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self.receive()
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def receive(self):
        while b"\0" not in self.buffer:
            data = os.read(self.ours_in, 1 << 20)
            if not data:
                raise RuntimeError("chromium has ended")
            self.buffer += data
        message, _, self.buffer = self.buffer.partition(b"\0")
        return json.loads(message)

    def open(self, url, timeout=120):
        """Load a report and wait until it says that all is drawn."""
        self.events.clear()
        self.call("Page.navigate", url=url)
        deadline = time.monotonic() + timeout
        ready = f"location.href === {json.dumps(url)} && document.body?.dataset.ready"
        while self.evaluate(ready) != "1":
            if time.monotonic() > deadline:
                raise TimeoutError(f"{url} is not ready: {self.complaints()}")
            time.sleep(0.1)

    def evaluate(self, expression):
        """Value of a JavaScript expression; promises are awaited."""
        result = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in result:
            raise RuntimeError(result["exceptionDetails"])
        return result["result"].get("value")

    def mouse(self, kind, x, y):
        """Send one event of the mouse: mouseMoved, mousePressed or mouseReleased."""
        button = "none" if kind == "mouseMoved" else "left"
        count = 0 if kind == "mouseMoved" else 1
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=count)

    def drag(self, *points):
        """Press the left button at the first point, move through the others, and let it go."""
        for at, (x, y) in enumerate(points):
            kind = "mouseMoved" if at else "mousePressed"
            self.call(
                "Input.dispatchMouseEvent",
                **{"type": kind, "x": x, "y": y, "button": "left", "buttons": 1, "clickCount": 1},
            )
        self.mouse("mouseReleased", *points[-1])

    def click(self, x, y):
        """Press and release the left button."""
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)

    def screenshot(self):
        """(H, W, 3) uint8 BGR of what is seen."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)

    def resize(self, width, height=900):
        """Give the window another size, and let the page lay itself out."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        frames = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
        self.evaluate(frames + ".then(() => 1)")

    def press(self, key):
        """Press a key and let it go."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def pdf(self):
        """The page as it is printed, without backgrounds, as browsers do unless told otherwise."""
        return base64.b64decode(self.call("Page.printToPDF", printBackground=False)["data"])

    def complaints(self):
        """Errors of scripts, of the console and of what was loaded."""
        found = []
        for event in self.events:
            params, method = event.get("params", {}), event.get("method")
            if method == "Runtime.exceptionThrown":
                found.append(params["exceptionDetails"])
            elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
                found.append([argument.get("value") for argument in params["args"]])
            elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
                found.append(params["entry"]["text"])
        return found

    def requests(self):
        """Addresses asked for that are not within the page."""
        urls = (
            event["params"]["request"]["url"]
            for event in self.events
            if event.get("method") == "Network.requestWillBeSent"
        )
        return [url for url in urls if not url.startswith(("data:", "blob:"))]
