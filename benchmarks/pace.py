"""How fast the page runs in Chromium without a graphics card: simulated seconds per second.

    python benchmarks/pace.py [--seconds 10]

The packaged `drive` walks at 1 m/s. A row for each pace of time that is asked for, and one for a
processor that the browser makes four times slower. Run it on an idle machine.
"""

import time

from benchmarks.shared import make_parser
from quadwalk.cli.process import run_command
from quadwalk.evaluation.load import load_run
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run
from quadwalk.web import site
from quadwalk.web.serve import serve_page
from tests.web.browser import Browser, open_browser, wait_until

CASES = ((1, 1), (2, 1), (4, 1), (1, 4))  # pace, by how much the processor is slower
SETTLE = 4.0  # s before a pace is measured: the page adapts its pixels
CLOCKS = "[quadwalk.simulation.time, performance.now() / 1000]"


def measure_pace(browser: Browser, seconds: float) -> float:
    """Return simulated seconds for each second, over `seconds`."""
    start = browser.evaluate(CLOCKS)
    time.sleep(seconds)
    end = browser.evaluate(CLOCKS)
    return (end[0] - start[0]) / (end[1] - start[1])


def main() -> None:
    """Print the table."""
    parser = make_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each row")
    options = parser.parse_args()
    drive, getup = (load_run(Run(PRETRAINED / name), 1.0) for name in ("drive", "getup"))
    files = site.make_site([site.make_dog(drive, getup)], site.make_ground(drive.env), live=False)
    print("| pace asked for | processor slower by | pace |\n|---|---|---|")
    with serve_page("127.0.0.1", 8320) as server:
        server.set_files(files)
        with open_browser(server.url) as browser:
            started = "(globalThis.quadwalk?.simulation?.time ?? 0) > 0.5"
            wait_until(lambda: browser.evaluate(started))
            browser.send_key("keyDown", "KeyW")
            for pace, slower in CASES:
                browser.evaluate(f"quadwalk.act('pace', {pace})")
                browser.ask("Emulation.setCPUThrottlingRate", rate=slower)
                time.sleep(SETTLE)
                print(f"| {pace} | {slower} | {measure_pace(browser, options.seconds):.2f} |")


if __name__ == "__main__":
    run_command(main)
