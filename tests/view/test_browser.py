"""The page in a real browser: it is driven by its keys, and the picture moves."""

import io
import time
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from quadwalk.runs.directory import Run
from tests.view.browser import PROGRAM, Browser, browsing, running, wait

pytest.importorskip("mjviser", reason="mjviser is not installed: pip install 'quadwalk[view]'")
if PROGRAM is None:
    pytest.skip("there is no chromium: apt-get install chromium", allow_module_level=True)

from quadwalk.view.page import Page
from quadwalk.view.server import serving


@pytest.fixture(scope="module")
def page(runs) -> Iterator[Page]:
    """A page, with the robot running in it in a thread."""
    with serving("127.0.0.1", 8310, Console(quiet=True)) as server:
        page = Page(server, Run(runs / "dog"), runs)
        with running(page):
            yield page


@pytest.fixture(scope="module")
def browser(page) -> Iterator[Browser]:
    with browsing(f"http://localhost:{page._server.get_port()}") as browser:
        browser.wait_for("steps of training")
        browser.dismiss()
        yield browser


def test_the_page_shows_who_runs_and_its_controls(page, browser):
    text = browser.text()
    for said in (page.run.name, "forward, m/s", "Push", "friction", "motor strength", "policy"):
        assert said in text


def test_keys_move_the_command_and_not_the_camera(page, browser):
    (client,) = page._server.get_clients().values()
    before = np.array(client.camera.position)
    for _ in range(4):
        browser.press("W")
    browser.press("A")
    assert wait(lambda: np.allclose(page.live.command, [0.6, 0.0, 0.1]))
    # The slider shows what the key did.
    shown = "[...document.querySelectorAll('input')].map(x => x.value)"
    assert wait(lambda: "0.6" in browser.evaluate(shown))
    time.sleep(1.0)
    assert np.array(client.camera.position) == pytest.approx(before, abs=1e-3)


def test_the_robot_moves_and_the_picture_with_it(page, browser):
    """It is pushed, and held where it is then."""
    browser.press("R")
    assert wait(lambda: page.live.time < 1.0)
    browser.press("K")
    assert wait(lambda: "paused" in browser.text())
    place, still = page.live.data.qpos.copy(), scene(browser)
    assert np.abs(scene(browser) - still).mean() < 0.5
    browser.press("P")
    browser.press("K")
    assert wait(lambda: np.abs(page.live.data.qpos[:2] - place[:2]).max() > 0.05)
    browser.press("K")
    assert wait(lambda: "paused" in browser.text())
    moved = scene(browser)
    assert np.abs(moved - still).mean() > 1.0
    assert moved.std() > 5.0  # it is no blank
    browser.press("K")


def scene(browser: Browser) -> np.ndarray:
    """(h, w, 3) the middle of the page, where nothing but the robot and the floor is drawn."""
    picture = Image.open(io.BytesIO(browser.screenshot())).convert("RGB")
    picture = np.asarray(picture).astype(float)
    height, width, _ = picture.shape
    return picture[: height // 2, width // 3 : int(0.6 * width)]
