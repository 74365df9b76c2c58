"""Real time: what is due, and whether it is kept, by a clock that the test moves."""

import pytest

from quadwalk.view.pace import Pace

DT = 0.02


class Clock:
    """Tells the time that it is set to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def played(speed: float, cost: float, seconds: float = 5.0) -> tuple[Pace, int]:
    """Steps that each take `cost` s of computing, over so many seconds; how many there were."""
    clock = Clock()
    pace = Pace(DT, clock)
    pace.speed = speed
    end, steps = clock.now + seconds, 0
    while clock.now < end:
        for _ in range(pace.due()):
            clock.now += cost
            pace.done(cost)
            steps += 1
        clock.now += 0.002
    return pace, steps


@pytest.mark.parametrize("speed", [1.0, 0.5, 0.25, 0.1])
def test_time_goes_as_fast_as_is_asked_for(speed):
    pace, steps = played(speed, cost=0.001)
    assert steps * DT == pytest.approx(5.0 * speed, abs=2 * DT)
    assert pace.kept
    assert pace.reached == pytest.approx(speed, rel=0.05)
    assert pace.most == pytest.approx(20.0, rel=0.01)


def test_it_is_known_when_time_is_not_kept():
    """Steps of 20 ms that take 40."""
    pace, steps = played(1.0, cost=0.04)
    assert not pace.kept
    assert pace.reached == pytest.approx(0.5, rel=0.1)
    assert pace.most == pytest.approx(0.5, rel=0.01)
    assert steps * DT == pytest.approx(2.5, rel=0.1)


def test_what_was_missed_is_not_made_up():
    clock = Clock()
    pace = Pace(DT, clock)
    clock.now += 60.0
    assert 1 <= pace.due() <= 6  # a tenth of a second, not a minute


def test_after_a_pause_nothing_is_due():
    clock = Clock()
    pace = Pace(DT, clock)
    clock.now += 1.0
    pace.restart()
    assert pace.due() == 0
    assert pace.kept


def test_one_that_stands_still_is_not_kept():
    """No step is made for a long time: it is not what was reached before."""
    pace, _ = played(1.0, cost=0.001)
    clock = pace._clock
    clock.now += 10.0
    assert not pace.kept
