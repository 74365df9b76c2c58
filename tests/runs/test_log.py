import errno
import json
import math
import os

import jax.numpy as jnp
import numpy as np
import pytest

from quadwalk.errors import UserError
from quadwalk.runs import log
from quadwalk.runs.directory import Run, create_run


@pytest.fixture
def run(tmp_path):
    return create_run(tmp_path, "a")


def write(run, *steps, resume_at=None):
    with log.MetricsLog(run, resume_at) as metrics:
        for count in steps:
            metrics.append({"steps": count, "train/speed": count / 7}, {"time/elapsed": 2.0})


def strict(line):
    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    return json.loads(line, parse_constant=refuse)


def test_numbers_of_every_sort_become_plain_json(run):
    with log.MetricsLog(run) as metrics:
        numbers = {"a": np.float32(0.1), "b": jnp.float32(2.5), "c": 3, "d": np.array([4.0])}
        none = {"e": float("nan"), "f": jnp.inf, "g": -np.inf}
        metrics.append({"steps": np.int64(2**40), **numbers, **none})
    row = strict(run.metrics.read_text())
    numbers = {"a": float(np.float32(0.1)), "b": 2.5, "c": 3, "d": 4.0}
    assert row == {"steps": 2**40, **numbers, **dict.fromkeys("efg")}
    assert math.isnan(log.read_metrics(run)[0]["e"])


def test_each_row_is_there_at_once(run):
    assert log.read_metrics(run) == []  # nothing yet
    metrics = log.MetricsLog(run)
    for count in (0, 1, 2):
        assert len(log.read_metrics(run)) == count
        metrics.append({"steps": count})
    metrics.close()


def test_equal_trainings_give_equal_files_whatever_the_clock_says(tmp_path):
    runs = [create_run(tmp_path, name) for name in "ab"]
    for seconds, run in enumerate(runs):
        with log.MetricsLog(run) as metrics:
            metrics.append({"steps": 1, "x": 1 / 3}, {"time/elapsed": seconds})
    assert runs[0].metrics.read_bytes() == runs[1].metrics.read_bytes()
    assert [log.read_history(run)[0]["time/elapsed"] for run in runs] == [0, 1]


def test_history_joins_what_there_is(run):
    with log.MetricsLog(run) as metrics:
        metrics.append({"steps": 1, "x": 1.0})
        metrics.append({"steps": 2, "x": 2.0}, {"time/elapsed": 5})
    assert log.read_history(run) == [
        {"steps": 1, "x": 1.0},
        {"steps": 2, "x": 2.0, "time/elapsed": 5},
    ]


def test_a_torn_line_is_cut_off(run):
    write(run, 1, 2)
    content = run.metrics.read_bytes()
    first = content.index(b"\n") + 1
    for torn in (content[:-3], content[:first] + bytes(100)):  # zeros: after a power cut
        run.metrics.write_bytes(torn)
        write(run, 2)
        assert run.metrics.read_bytes() == content


def test_the_last_row_is_the_last_that_is_whole(tmp_path):
    run = Run(tmp_path)
    assert log.read_last_row(run) is None
    run.metrics.write_text('{"steps": 6')
    assert log.read_last_row(run) is None
    rows = [
        {"steps": steps, "x": math.nan, **dict.fromkeys("abcdefgh", 0.5)} for steps in range(999)
    ]
    with log.MetricsLog(run) as metrics:
        for row in rows:
            metrics.append(row)
    with open(run.metrics, "a") as file:
        file.write('{"steps": 704, "eva')
    np.testing.assert_equal(log.read_last_row(run), rows[-1])


def scalars(run):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    events = accumulator.EventAccumulator(str(run.tensorboard)).Reload()
    return {
        tag: [(event.step, event.value) for event in events.Scalars(tag)]
        for tag in events.Tags()["scalars"]
    }


def test_resumed_equals_uninterrupted(tmp_path):
    whole, broken = create_run(tmp_path, "whole"), create_run(tmp_path, "broken")
    write(whole, 1, 2, 3, 4)
    write(broken, 1, 2, 3)  # the last checkpoint was at 2
    write(broken, 3, 4, resume_at=2)
    assert broken.metrics.read_bytes() == whole.metrics.read_bytes()
    assert broken.timing.read_bytes() == whole.timing.read_bytes()
    assert scalars(broken) == {
        "train/speed": [(step, pytest.approx(step / 7)) for step in (1, 2, 3, 4)],
        "time/elapsed": [(step, 2.0) for step in (1, 2, 3, 4)],
    }


def test_tensorboard_is_current_after_sync(run):
    with log.MetricsLog(run) as metrics:
        metrics.append({"steps": 1, "x": 1.0})
        metrics.append({"steps": 2, "x": float("nan")})
        metrics.sync()
        assert len(scalars(run)["x"]) == 2


def test_no_room_keeps_every_whole_row(run, monkeypatch):
    real = os.write
    room = 60

    def nearly_full(descriptor, data):
        nonlocal room
        if room == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = real(descriptor, data[:room])
        room -= written
        return written

    metrics = log.MetricsLog(run)
    monkeypatch.setattr(os, "write", nearly_full)
    metrics.append({"steps": 1, "train/speed": 1.0})
    with pytest.raises(UserError, match=r"cannot write .*metrics\.jsonl: No space left on device"):
        metrics.append({"steps": 2, "train/speed": 2.0})
    room = 1000  # someone tidied up
    metrics.append({"steps": 3, "train/speed": 3.0})
    assert [row["steps"] for row in log.read_metrics(run)] == [1, 2, 3]
    room = 0
    with pytest.raises(UserError, match="No space left"):
        metrics.append({"steps": 4, "train/speed": 4.0})
    with pytest.raises(UserError, match="No space left"):
        metrics.sync()  # or a checkpoint would count on a row that is not there
    room = 1000
    metrics.sync()
    metrics.close()
    assert [row["steps"] for row in log.read_metrics(run)] == [1, 2, 3, 4]
    assert run.metrics.read_bytes().count(b"\n") == 4


def test_tensorboard_begins_anew_when_there_is_room_again(run, monkeypatch):
    metrics = log.MetricsLog(run)
    metrics.append({"steps": 1, "x": 1.0})
    with monkeypatch.context() as patch:

        def full(_):
            raise OSError(errno.ENOSPC, "No space left on device")

        patch.setattr(metrics._events._writer, "write", full)
        with pytest.raises(UserError, match="cannot write TensorBoard events"):
            metrics.append({"steps": 2, "x": 2.0})
    metrics.append({"steps": 3, "x": 3.0})
    metrics.close()
    assert [step for step, _ in scalars(run)["x"]] == [1, 3]
    assert [row["steps"] for row in log.read_metrics(run)] == [1, 2, 3]


def test_a_folder_that_went_away_is_named(run):
    metrics = log.MetricsLog(run)
    run.tensorboard.rmdir()
    run.tensorboard.write_text("in the way")
    with pytest.raises(UserError, match=r"cannot write TensorBoard events in .*tensorboard"):
        metrics.append({"steps": 1, "x": 1.0})
    metrics.close()
