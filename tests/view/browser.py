"""A real browser without a screen: Debian's chromium, spoken to by the DevTools protocol."""

import base64
import contextlib
import itertools
import json
import shutil
import subprocess
import tempfile
import threading
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


def wait(condition: Callable[[], bool], seconds: float = 30.0) -> bool:
    """Whether `condition` comes true in time."""
    end = time.monotonic() + seconds
    while not (met := condition()) and time.monotonic() < end:
        time.sleep(0.1)
    return met


class Browser:
    """One page."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._numbers = socket, itertools.count(1)

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the protocol; its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression in the page."""
        answer = self.ask("Runtime.evaluate", expression=expression, returnByValue=True)
        return answer["result"].get("value")

    def text(self) -> str:
        """What the page says."""
        return self.evaluate("document.body.innerText") or ""

    def wait_for(self, text: str, seconds: float = 60.0) -> None:
        """Wait until the page says `text`."""
        assert wait(lambda: text in self.text(), seconds), f"no {text!r} in: {self.text()}"

    def dismiss(self, seconds: float = 20.0) -> None:
        """Close what the page complains of, as of no graphics card, once it does."""
        close = "document.querySelector('.mantine-Notification-closeButton')"
        wait(lambda: self.evaluate(f"!!{close}"), seconds)
        self.evaluate(f"{close}?.click()")

    def press(self, key: str) -> None:
        """Press a letter's key, or the space bar, and let it go."""
        code = "Space" if key == " " else f"Key{key}"
        names = {"key": key.lower(), "code": code, "windowsVirtualKeyCode": ord(key)}
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, **names)

    def resize(self, width: int, height: int) -> None:
        """Give the page so many pixels."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.ask("Emulation.setDeviceMetricsOverride", **size)

    def screenshot(self) -> bytes:
        """A picture of the page, PNG."""
        return base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])


@contextlib.contextmanager
def browsing(url: str) -> Iterator[Browser]:
    """A browser that shows `url`."""
    from websockets.sync.client import connect

    assert PROGRAM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [PROGRAM, *_FLAGS.split(), f"--user-data-dir={folder}", "about:blank"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            file = Path(folder) / "DevToolsActivePort"
            listens = wait(lambda: file.exists() and "\n" in file.read_text(), 60.0)
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


@contextlib.contextmanager
def running(page: Any) -> Iterator[None]:
    """Have the robot of a `quadwalk.view.page.Page` run meanwhile, in a thread."""
    over = threading.Event()

    def play() -> None:
        while not over.is_set():
            page.run_for(0.2)

    thread = threading.Thread(target=play)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
