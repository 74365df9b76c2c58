"""Real time: what is due, and whether it is kept, by a clock that the test moves."""

from types import SimpleNamespace

import pytest

from quadwalk.view.pace import Pace

DT = 0.02


def paced() -> tuple[Pace, SimpleNamespace]:
    """A pace, and its clock, which tells the time that `now` is set to."""
    clock = SimpleNamespace(now=100.0)
    return Pace(DT, lambda: clock.now), clock


def played(speed: float, cost: float) -> tuple[Pace, SimpleNamespace, int]:
    """Steps that each take `cost` s of computing, over 5 s; how many there were."""
    pace, clock = paced()
    pace.speed, steps = speed, 0
    while clock.now < 105.0:
        for _ in range(pace.due()):
            clock.now += cost
            pace.done(cost)
            steps += 1
        clock.now += 0.002
    return pace, clock, steps


@pytest.mark.parametrize("speed", [1.0, 0.5, 0.25, 0.1])
def test_time_goes_as_fast_as_is_asked_for(speed):
    pace, _, steps = played(speed, cost=0.001)
    assert steps * DT == pytest.approx(5.0 * speed, abs=2 * DT)
    assert pace.kept
    assert pace.reached == pytest.approx(speed, rel=0.05)
    assert pace.most == pytest.approx(20.0, rel=0.01)


def test_it_is_known_when_time_is_not_kept():
    pace, _, steps = played(1.0, cost=0.04)
    assert not pace.kept
    assert pace.reached == pytest.approx(0.5, rel=0.1)
    assert pace.most == pytest.approx(0.5, rel=0.01)
    assert steps * DT == pytest.approx(2.5, rel=0.1)


def test_what_was_missed_is_not_made_up_and_after_a_pause_nothing_is_due():
    pace, clock = paced()
    clock.now += 60.0
    assert 1 <= pace.due() <= 6  # a tenth of a second, not a minute
    clock.now += 1.0
    pace.restart()
    assert pace.due() == 0
    assert pace.kept


def test_one_that_stands_still_is_not_kept():
    """No step is made for a long time: it is not what was reached before."""
    pace, clock, _ = played(1.0, cost=0.001)
    clock.now += 10.0
    assert not pace.kept
