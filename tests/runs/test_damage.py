"""Damage of a run's files: bytes that are cut, flipped or overwritten never give wrong data."""

import json
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from quadwalk.errors import UserError
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run
from quadwalk.runs.log import MetricsLog, read_metrics

TREE = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": (np.int32(5), np.ones(3))}
ROWS = [{"steps": steps, "x": steps / 7} for steps in (1, 2, 3)]
many = settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def load_or_refuse(load: Callable[[], object], path) -> object:
    """Return what is read, or None for a `UserError`, which names the file."""
    refusal = ""
    try:
        return load()
    except UserError as error:
        refusal = str(error)
    assert path.name in refusal
    return None


@pytest.fixture
def archive(tmp_path):
    """Check what is read in place of a saved tree: it, or nothing."""
    path = tmp_path / "policy.npz"
    checkpoint.save(path, TREE, {"kind": "policy", "steps": 12})

    def check(content: bytes) -> bool:
        path.write_bytes(content)
        loaded = load_or_refuse(lambda: checkpoint.load(path, "policy", like=TREE), path)
        if loaded is None:
            return False
        tree, metadata = loaded
        np.testing.assert_equal(tree, TREE)
        assert metadata == {"kind": "policy", "steps": 12}
        return True

    return path.read_bytes(), check


@pytest.fixture
def log(tmp_path):
    """Check what is read in place of `ROWS`: nothing, or rows of which one at most is another."""
    run = Run(tmp_path)
    with MetricsLog(run) as metrics:
        for row in ROWS:
            metrics.append(row)

    def check(content: bytes) -> bool:
        run.metrics.write_bytes(content)
        rows = load_or_refuse(lambda: read_metrics(run), run.metrics)
        if rows is None:
            return False
        assert all(isinstance(value, int | float) for row in rows for value in row.values())
        unknown = [row for row in rows if row not in ROWS]
        assert len(unknown) <= 1
        return not unknown

    return run.metrics.read_bytes(), check


@pytest.mark.parametrize("kind", ["archive", "log"])
@many
@given(data=st.data())
def test_damaged_bytes_give_an_error_or_equal_data(kind, request, data):
    content, check = request.getfixturevalue(kind)
    start = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):  # bits of one byte
        piece = bytes([content[start] ^ data.draw(st.integers(1, 255))])
    else:
        # Within a line: what damages more is the next test's.
        room = content.find(b"\n", start) - start if kind == "log" else 64
        piece = data.draw(st.binary(max_size=max(0, min(64, room))))
    check(content[:start] + piece + content[start + len(piece) :])


def test_an_archive_that_is_cut_short_is_refused(archive):
    content, check = archive
    for size in range(len(content)):
        assert not check(content[:size]), size


def test_a_log_that_is_cut_short_keeps_its_whole_rows(log, tmp_path):
    content, check = log
    for size in range(len(content)):
        assert check(content[:size])
        assert read_metrics(Run(tmp_path)) == ROWS[: content[:size].count(b"\n")]


@pytest.mark.parametrize(
    "line",
    [
        *(b"x", b"[1]", b"{}", b'{"steps": null}', b"\xff", b"", b"3", b"[" * 100_000),
        *(b'{"steps": 1e999}', b'{"steps": 2, "a": "b"}', b'{"steps": 2, "a": 1%0400d}' % 0),
    ],
    ids=lambda line: line[:30],
)
def test_a_line_that_is_no_row_is_named(tmp_path, line):
    rows = [json.dumps(row).encode() for row in ROWS]
    (tmp_path / "metrics.jsonl").write_bytes(b"\n".join((rows[0], line, *rows[1:], b"")))
    with pytest.raises(UserError, match=r"metrics\.jsonl, line 2: expected"):
        read_metrics(Run(tmp_path))
