"""The page in a real browser: it loads, is driven by held keys, and works as one file."""

import io
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image

import quadwalk
from quadwalk.paths import PRETRAINED
from quadwalk.web import site
from quadwalk.web.serve import PageServer, serve_page
from tests.web.browser import PROGRAM, Browser, open_browser, wait_until

if PROGRAM is None:
    pytest.skip("there is no chromium: apt-get install chromium", allow_module_level=True)

WANTED = "quadwalk.pilot.wanted.map(x => Math.round(100 * x) / 100)"


@pytest.fixture(scope="module")
def files(loaded_runs, vendor_files) -> dict[str, bytes]:
    """Return the page's files, with `drive` and `run`."""
    dogs = [
        site.make_dog(loaded_runs["drive"], loaded_runs["getup"]),
        site.make_dog(loaded_runs["run"]),
    ]
    return site.make_site(dogs, site.make_ground(loaded_runs["drive"].env), live=True)


@pytest.fixture(scope="module")
def server(files) -> Iterator[PageServer]:
    with serve_page("127.0.0.1", 8310) as server:
        server.set_files(files)
        yield server


@pytest.fixture(scope="module")
def browser(server) -> Iterator[Browser]:
    with open_browser(server.url) as browser:
        assert is_running(browser), browser.text()
        yield browser


def is_running(browser: Browser) -> bool:
    """Return True once the simulation runs, False if it does not in time."""
    started = "(globalThis.quadwalk?.simulation?.time ?? 0) > 0.1"
    return wait_until(lambda: browser.evaluate(started))


def take_picture(browser: Browser) -> np.ndarray:
    """Return the picture of the page's middle (rows, columns, 3)."""
    picture = Image.open(io.BytesIO(browser.screenshot())).convert("RGB")
    pixels = np.asarray(picture).astype(float)
    height, width, _ = pixels.shape
    return pixels[height // 4 : 3 * height // 4, width // 3 : 2 * width // 3]


def test_it_runs_by_itself_until_a_key_is_held(browser):
    assert "W A S D" in browser.text()
    assert "drive: trained in 82,010,112 steps" in browser.text()
    moving = "quadwalk.pilot.command[0] > 0.5"
    assert wait_until(lambda: browser.evaluate(moving))
    assert browser.evaluate("quadwalk.pilot.script !== null")
    browser.press("KeyS")
    assert browser.evaluate("quadwalk.pilot.script === null")


def test_keys_are_held_together_and_released(browser):
    browser.send_key("keyDown", "KeyW")
    assert browser.evaluate(WANTED) == [1.0, 0.0, 0.0]
    browser.send_key("keyDown", "KeyA")
    browser.send_key("keyDown", "ShiftLeft")
    assert browser.evaluate(WANTED)[0] == 4.0
    assert browser.evaluate(WANTED)[2] > 0.9
    for code in ("ShiftLeft", "KeyA"):
        browser.send_key("keyUp", code)
    assert browser.evaluate(WANTED) == [1.0, 0.0, 0.0]
    browser.evaluate("dispatchEvent(new Event('blur'))")
    assert browser.evaluate(WANTED) == [0.0, 0.0, 0.0]
    browser.send_key("keyUp", "KeyW")


def test_space_stops_wherever_the_focus_is(browser):
    browser.evaluate("document.getElementById('panel').open = true")
    browser.send_key("keyDown", "KeyW")
    browser.evaluate("document.querySelector('#controls input').focus()")
    browser.press("Space")
    assert browser.evaluate(WANTED) == [0.0, 0.0, 0.0]
    assert browser.evaluate("quadwalk.pilot.isStopped")
    browser.send_key("keyUp", "KeyW")
    browser.evaluate("document.getElementById('panel').open = false")


def test_the_picture_moves_with_the_robot_and_stays_while_it_is_paused(browser):
    assert wait_until(lambda: browser.evaluate("Math.abs(quadwalk.simulation.velocity[0]) < 0.05"))
    browser.press("KeyP")
    assert wait_until(lambda: "paused" in browser.text())
    pictures = [take_picture(browser)]

    def is_still() -> bool:
        pictures.append(take_picture(browser))
        return bool(np.abs(pictures[-1] - pictures[-2]).mean() < 0.1)

    assert wait_until(is_still)  # the camera comes to rest
    still = pictures[-1]
    assert still.std() > 5.0
    browser.press("KeyP")
    before = browser.evaluate("quadwalk.simulation.data.qpos[1]")
    browser.press("KeyK")
    condition = f"Math.abs(quadwalk.simulation.data.qpos[1] - {before}) > 0.05"
    assert wait_until(lambda: browser.evaluate(condition))
    assert wait_until(lambda: np.abs(take_picture(browser) - still).mean() > 1.0)


def test_settings_change_the_robot_and_a_link_carries_them(browser):
    browser.evaluate("quadwalk.act('friction', 0.3); quadwalk.act('payload', 6)")
    friction = "Array.from(quadwalk.simulation.model.geom_friction).slice(0, 1)"
    assert browser.evaluate(friction) == [0.3]
    browser.evaluate("quadwalk.copyLink()")
    assert browser.evaluate("location.hash").startswith("#dog=drive&friction=0.3&payload=6&do=")
    browser.evaluate("quadwalk.act('defaults', true)")
    assert browser.evaluate(friction) == [0.8]


def test_uneven_ground_ends_with_a_word(browser):
    browser.evaluate("quadwalk.choose('drive', 'waves, 0.4')")
    assert wait_until(lambda: browser.evaluate("quadwalk.ground") == "waves, 0.4")
    browser.evaluate("quadwalk.simulation.data.qpos[0] = quadwalk.terrain.edges[1] - 1")
    assert wait_until(lambda: "end of the field" in browser.text())
    browser.evaluate("quadwalk.choose('drive', 'flat')")
    assert wait_until(lambda: browser.evaluate("quadwalk.ground") == "flat")


def test_a_newer_policy_arrives(browser, server, files):
    server.send_policy(files["run.policy.json"])
    assert wait_until(lambda: "run: trained in" in browser.text())
    task = "quadwalk.simulation.driver.metadata.task"
    assert browser.evaluate(task) == "run"
    server.send_policy(files["drive.policy.json"])
    assert wait_until(lambda: browser.evaluate(task) == "drive")


def test_a_phone_has_sticks_and_its_panel_folded(browser):
    browser.resize(390, 780, mobile=True)
    sizes = browser.evaluate(
        "[...document.querySelectorAll('#touch button')].map(b => b.getBoundingClientRect().height)"
    )
    assert min(sizes) >= 44
    assert browser.evaluate("document.getElementById('stick-left').offsetWidth") >= 88
    assert not browser.evaluate("document.getElementById('panel').open")
    browser.resize(900, 600)


def test_a_page_whose_server_has_ended_says_so(files):
    with serve_page("127.0.0.1", 8330) as server:
        server.set_files(files)
        with open_browser(server.url) as browser:
            assert is_running(browser)
            server.close()
            assert wait_until(lambda: "has ended" in browser.text())


def test_one_file_runs_without_a_server(files, tmp_path):
    file = tmp_path / "dog.html"
    file.write_bytes(site.to_single_file(files))
    with open_browser(file.as_uri()) as browser:
        assert is_running(browser), browser.text()
        assert browser.evaluate("quadwalk.dogs.length") == 2


def test_a_notebook_shows_the_page_in_a_frame(vendor_files):
    cell = quadwalk.play(PRETRAINED / "walk", height=300)._repr_html_()
    content = f"<!doctype html><meta charset='utf-8'>{cell}".encode()
    inside = "document.querySelector('iframe')?.contentWindow?.quadwalk?.simulation?.time ?? 0"
    with serve_page("127.0.0.1", 8350) as server:
        server.set_files({site.INDEX: content})
        with open_browser(server.url) as browser:
            assert wait_until(lambda: browser.evaluate(inside) > 0.1)
