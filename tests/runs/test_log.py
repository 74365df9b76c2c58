"""The log of each iteration: the same for the same seed, and whole on a full disk."""

import errno
import json
import math
import os

import jax.numpy as jnp
import numpy as np
import pytest

from quadwalk.errors import UserError
from quadwalk.runs.directory import Run, create_run
from quadwalk.runs.log import MetricsLog, read_history, read_last_row, read_metrics


@pytest.fixture
def run(tmp_path) -> Run:
    return create_run(tmp_path, "a")


def write(run: Run, *steps: int, resume_at: int | None = None, seconds: float = 2.0) -> None:
    with MetricsLog(run, resume_at) as log:
        for count in steps:
            log.append({"steps": count, "train/speed": count / 7}, {"time/elapsed": seconds})


def read_steps(run: Run) -> list[int]:
    return [row["steps"] for row in read_metrics(run)]


def read_scalars(run: Run) -> dict[str, list[tuple[int, float]]]:
    """Return step and value of each TensorBoard event, as TensorBoard reads them."""
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    events = accumulator.EventAccumulator(str(run.tensorboard)).Reload()
    return {
        tag: [(event.step, event.value) for event in events.Scalars(tag)]
        for tag in events.Tags()["scalars"]
    }


def test_numbers_of_every_sort_become_plain_json(run):
    with MetricsLog(run) as log:
        numbers = {"a": np.float32(0.1), "b": jnp.float32(2.5), "c": 3, "d": np.array([4.0])}
        none = {"e": float("nan"), "f": jnp.inf, "g": -np.inf}
        log.append({"steps": np.int64(2**40), **numbers, **none})
    row = json.loads(run.metrics.read_text(), parse_constant=pytest.fail)
    numbers = {"a": float(np.float32(0.1)), "b": 2.5, "c": 3, "d": 4.0}
    assert row == {"steps": 2**40, **numbers, **dict.fromkeys("efg")}
    assert math.isnan(read_metrics(run)[0]["e"])


def test_each_row_is_there_at_once_and_tensorboard_after_a_sync(run):
    assert read_metrics(run) == []  # nothing yet
    with MetricsLog(run) as log:
        for count in (0, 1, 2):
            assert len(read_metrics(run)) == count
            log.append({"steps": count, "x": float("nan")})
        log.sync()
        assert len(read_scalars(run)["x"]) == 3


def test_equal_trainings_give_equal_files_whatever_the_clock_says(tmp_path):
    runs = [create_run(tmp_path, name) for name in "ab"]
    for seconds, run in enumerate(runs):
        write(run, 1, 2, seconds=seconds)
        with MetricsLog(run) as log:
            log.append({"steps": 3, "train/speed": 1.0})
        expected = [{"time/elapsed": seconds}] * 2 + [{}]
        assert read_history(run) == [
            {**row, **timing} for row, timing in zip(read_metrics(run), expected, strict=True)
        ]
    assert runs[0].metrics.read_bytes() == runs[1].metrics.read_bytes()


def test_a_torn_line_is_cut_off(run):
    write(run, 1, 2)
    content = run.metrics.read_bytes()
    first = content.index(b"\n") + 1
    for torn in (content[:-3], content[:first] + bytes(100)):  # zeros: after a power cut
        run.metrics.write_bytes(torn)
        write(run, 2)
        assert run.metrics.read_bytes() == content


def test_the_last_row_is_the_last_that_is_whole(run):
    assert read_last_row(run) is None
    run.metrics.write_text('{"steps": 6')
    assert read_last_row(run) is None
    run.metrics.unlink()
    rows = [{"steps": steps, "x": math.nan, "y" * 99: 0.5} for steps in range(999)]
    with MetricsLog(run) as log:
        for row in rows:
            log.append(row)
    with open(run.metrics, "a") as file:
        file.write('{"steps": 704, "eva')
    np.testing.assert_equal(read_last_row(run), rows[-1])


def test_resumed_equals_uninterrupted(tmp_path):
    whole, broken = create_run(tmp_path, "whole"), create_run(tmp_path, "broken")
    write(whole, 1, 2, 3, 4)
    write(broken, 1, 2, 3)  # the last checkpoint was at 2
    write(broken, 3, 4, resume_at=2)
    assert broken.metrics.read_bytes() == whole.metrics.read_bytes()
    assert broken.timing.read_bytes() == whole.timing.read_bytes()
    assert read_scalars(broken) == {
        "train/speed": [(step, pytest.approx(step / 7)) for step in (1, 2, 3, 4)],
        "time/elapsed": [(step, 2.0) for step in (1, 2, 3, 4)],
    }


def test_no_room_keeps_every_whole_row(run, monkeypatch):
    write_bytes = os.write
    room = 60

    def write_to_nearly_full(descriptor: int, data: bytes) -> int:
        nonlocal room
        if room == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        length = write_bytes(descriptor, data[:room])
        room -= length
        return length

    with MetricsLog(run) as log:
        monkeypatch.setattr(os, "write", write_to_nearly_full)
        log.append({"steps": 1, "train/speed": 1.0})
        with pytest.raises(UserError, match=r"cannot write .*metrics\.jsonl: No space left on"):
            log.append({"steps": 2, "train/speed": 2.0})
        assert read_steps(run) == [1]
        room = 1000  # someone tidied up
        log.append({"steps": 3, "train/speed": 3.0})
        assert read_steps(run) == [1, 2, 3]
        room = 0
        for refused in (lambda: log.append({"steps": 4, "train/speed": 4.0}), log.sync):
            with pytest.raises(UserError, match="No space left"):
                refused()  # or a checkpoint would count on a row that is not there
        room = 1000
        log.sync()
    assert read_steps(run) == [1, 2, 3, 4]
    assert run.metrics.read_bytes().count(b"\n") == 4


def test_tensorboard_begins_anew_when_there_is_room_again(run, monkeypatch):
    with MetricsLog(run) as log:
        log.append({"steps": 1, "x": 1.0})
        with monkeypatch.context() as patch:

            def refuse(_: bytes) -> None:
                raise OSError(errno.ENOSPC, "No space left on device")

            patch.setattr(log._events._writer, "write", refuse)
            with pytest.raises(UserError, match="cannot write TensorBoard events"):
                log.append({"steps": 2, "x": 2.0})
        log.append({"steps": 3, "x": 3.0})
    assert [step for step, _ in read_scalars(run)["x"]] == [1, 3]
    assert read_steps(run) == [1, 2, 3]


def test_a_folder_that_went_away_is_named(run):
    run.tensorboard.rmdir()
    run.tensorboard.write_text("in the way")
    expected = pytest.raises(UserError, match=r"cannot write TensorBoard events in .*tensorboard")
    with MetricsLog(run) as log, expected:
        log.append({"steps": 1, "x": 1.0})
