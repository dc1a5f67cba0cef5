"""A headless Chromium to open pages in, driven over its debugging port. Tests that use it are skipped where it is absent."""

import base64
import io
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import numpy as np

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--hide-scrollbars", "--mute-audio", "--no-first-run", "--disable-extensions", "--remote-debugging-port=0",
    "--disable-background-networking", "--disable-component-update",
)  # fmt: skip
HARMLESS = ("GPU stall due to ReadPixels", "favicon")
"""Messages of software drawing, and of a browser that looks for an icon."""


class Page:
    """One open page."""

    def __init__(self, socket, process):
        self._socket, self._numbers = socket, itertools.count(1)
        self.process = process
        """The number of the browser's first process."""
        self.troubles: list[str] = []
        """Errors and exceptions on the console."""
        self.requests: list[str] = []
        """Addresses that the page asked for."""
        for domain in ("Runtime", "Log", "Network", "Page"):
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]
            self._hear(answer)

    def _hear(self, event):
        params = event.get("params", {})
        if event["method"] == "Runtime.exceptionThrown":
            self.troubles.append(str(params["exceptionDetails"])[:500])
        elif event["method"] == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.troubles.append(str(params["args"])[:500])
        elif event["method"] == "Log.entryAdded" and params["entry"]["level"] == "error":
            text = f"{params['entry']['text']} {params['entry'].get('url', '')}"
            if not any(each in text for each in HARMLESS):
                self.troubles.append(text)
        elif event["method"] == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])

    def open(self, address):
        self.call("Page.navigate", url=address)
        self.wait("document.readyState === 'complete'")

    def run(self, script):
        """The value of an expression on the page; promises are awaited."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition, seconds=30.0):
        end = time.monotonic() + seconds
        while not self.run(f"Boolean({condition})"):
            assert time.monotonic() < end, f"{condition} did not come true; console: {self.troubles}"
            time.sleep(0.1)

    def png(self, whole=False):
        return base64.b64decode(self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)["data"])

    def picture(self):
        """What the page shows, (height, width, 3) bytes."""
        from PIL import Image

        return np.asarray(Image.open(io.BytesIO(self.png())).convert("RGB"))


def processor_seconds(page):
    """What the page's own process and the one that draws took since they began, by Linux's books."""
    told = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = status.read_text().rpartition(")")[2].split()
            kind = (
                (status.parent / "cmdline")
                .read_bytes()
                .decode()
                .replace("\0", " ")
                .partition("--type=")[2]
                .split(" ")[0]
            )
            told[int(status.parent.name)] = (
                int(words[1]),
                kind,
                (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK"),
            )
        except OSError:  # it ended meanwhile
            continue
    ours, grown = {page.process}, True
    while grown:
        more = {number for number, (parent, *_) in told.items() if parent in ours} - ours
        ours, grown = ours | more, bool(more)
    took = {"renderer": 0.0, "gpu-process": 0.0}
    for number in ours & set(told):
        _, kind, seconds = told[number]
        if kind in took:
            took[kind] += seconds
    return took


@contextmanager
def browser(width=1280, height=900):
    """A page of a Chromium that is gone when the block ends."""
    from websockets.sync.client import connect

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [PROGRAM, *FLAGS, f"--user-data-dir={folder}", f"--window-size={width},{height}", "about:blank"]
        running = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ | {"HOME": folder}
        )
        try:
            told = Path(folder) / "DevToolsActivePort"
            end = time.monotonic() + 30
            while not (told.exists() and told.read_text().strip()):
                assert time.monotonic() < end and running.poll() is None, "Chromium did not start"
                time.sleep(0.05)
            port = told.read_text().split()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=10) as answer:
                pages = [each for each in json.load(answer) if each["type"] == "page"]
            with connect(pages[0]["webSocketDebuggerUrl"], max_size=None) as socket:
                page = Page(socket, running.pid)
                page.call(
                    "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
                )
                yield page
        finally:
            running.terminate()
            running.wait(timeout=20)
