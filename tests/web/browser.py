"""A browser without a screen: Debian's Chromium, driven by the DevTools protocol."""

import base64
import contextlib
import itertools
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
_FLAGS = (
    "--headless=new --no-sandbox --use-gl=angle --use-angle=swiftshader --no-first-run "
    "--enable-unsafe-swiftshader --remote-debugging-port=0"
)


def wait_until(condition: Callable[[], bool], seconds: float = 120.0) -> bool:
    """Return True once `condition` holds, False if it does not in time."""
    end = time.monotonic() + seconds
    while not (holds := condition()) and time.monotonic() < end:
        time.sleep(0.1)
    return holds


class Browser:
    """A page of a browser, which obeys the DevTools protocol over `socket`."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._numbers = socket, itertools.count(1)

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the DevTools protocol with `params`; return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page."""
        answer = self.ask("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def text(self) -> str:
        """Return the text that the page shows."""
        return self.evaluate("document.body.innerText") or ""

    def send_key(self, kind: str, code: str) -> None:
        """Send "keyDown" or "keyUp" of the key `code`, its place on the keyboard such as "KeyW"."""
        key = " " if code == "Space" else code.removeprefix("Key").lower()
        self.ask("Input.dispatchKeyEvent", type=kind, code=code, key=key)

    def press(self, code: str) -> None:
        """Press the key `code`, named as for `send_key`, and let it go."""
        self.send_key("keyDown", code)
        self.send_key("keyUp", code)

    def resize(self, width: int, height: int, mobile: bool = False) -> None:
        """Give the page so many pixels, and the touch screen of a phone if it is `mobile`."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
        self.ask("Emulation.setDeviceMetricsOverride", **size)
        self.ask("Emulation.setTouchEmulationEnabled", enabled=mobile)

    def screenshot(self) -> bytes:
        """Return a picture of the page, as the bytes of a PNG file."""
        return base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])


@contextlib.contextmanager
def open_browser(url: str) -> Iterator[Browser]:
    """Return a context that gives a browser that shows `url`, and that ends it.

    Its page has 900 by 600 pixels.
    """
    from websockets.sync.client import connect

    assert PROGRAM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [PROGRAM, *_FLAGS.split(), f"--user-data-dir={folder}", "about:blank"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            file = Path(folder) / "DevToolsActivePort"
            listens = wait_until(lambda: file.exists() and "\n" in file.read_text())
            assert listens, "chromium does not start"
            port = file.read_text().split()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                pages = [page for page in json.load(answer) if page["type"] == "page"]
            with connect(pages[0]["webSocketDebuggerUrl"], max_size=None) as socket:
                browser = Browser(socket)
                browser.resize(900, 600)  # drawn without a graphics card: few pixels
                browser.ask("Page.navigate", url=url)
                yield browser
        finally:
            process.kill()
            process.wait()
