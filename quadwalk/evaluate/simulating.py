"""How far a simulation is, on the terminal."""

import contextlib
import time
from collections.abc import Iterator

from rich.console import Console

from quadwalk.evaluate.simulate import Report


@contextlib.contextmanager
def simulating(console: Console, what: str, steps: int, dt: float) -> Iterator[Report]:
    """Show a line about `what`, episodes of up to `steps` control steps of `dt` s, while it runs.

    Yields the function that is told the steps done; when all episodes end early, that is the end.
    """
    with console.status(f"{what}: compiling (up to half a minute, the first time)") as status:
        first: tuple[float, int] | None = None

        def report(done: int) -> None:
            nonlocal first
            now = time.monotonic()
            if first is None:  # what came before was compilation
                first = (now, done)
                left = ""
            else:
                pace = (now - first[0]) / (done - first[1])
                left = f", {pace * max(steps - done, 0):.0f} s left"
            status.update(f"{what}: {min(done, steps) * dt:.0f} of {steps * dt:g} s{left}")

        yield report
