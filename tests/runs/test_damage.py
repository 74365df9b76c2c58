"""Damage of a run's files: bytes that are cut, flipped or overwritten never give wrong data."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from quadwalk.errors import UserError
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run
from quadwalk.runs.log import MetricsLog, read_metrics

TREE = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": (np.int32(5), np.ones(3))}
METADATA = {"kind": "policy", "steps": 12}
ROWS = [{"steps": steps, "x": steps / 7} for steps in (1, 2, 3)]
FILES = ("policy.npz", "metrics.jsonl")


@pytest.fixture
def run(tmp_path) -> Run:
    """Return a run with a policy of `TREE` and with `ROWS`."""
    run = Run(tmp_path)
    checkpoint.save(run.policy, TREE, METADATA)
    with MetricsLog(run) as log:
        for row in ROWS:
            log.append(row)
    return run


def is_read(run: Run, file: str) -> bool:
    """Read a file; return False for a `UserError` that names it, and fail for wrong data."""
    refusal = None
    try:
        if file == "policy.npz":
            tree, metadata = checkpoint.load(run.policy, "policy", like=TREE)
            np.testing.assert_equal(tree, TREE)
            assert metadata == METADATA
        else:
            # One row, which has no checksum, may have another number.
            assert sum(row not in ROWS for row in read_metrics(run)) <= 1
    except UserError as error:
        refusal = str(error)
    assert refusal is None or file in refusal
    return refusal is None


@pytest.mark.parametrize("file", FILES)
@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(place=st.floats(0, 0.999), flipped=st.integers(1, 255), piece=st.binary(max_size=64))
def test_damaged_bytes_give_an_error_or_equal_data(run, file, place, flipped, piece):
    path = run.path / file
    content = path.read_bytes()
    start = int(place * len(content))
    if path.suffix == ".jsonl":  # within a line
        piece = piece[: content.index(b"\n", start) - start]
    for damage in (bytes([content[start] ^ flipped]), piece):
        path.write_bytes(content[:start] + damage + content[start + len(damage) :])
        is_read(run, file)  # some bits, such as dates, do not matter
    path.write_bytes(content)


@pytest.mark.parametrize("file", FILES)
def test_what_is_cut_short_is_refused_or_has_its_whole_rows(run, file):
    path = run.path / file
    content = path.read_bytes()
    for size in range(len(content)):
        path.write_bytes(content[:size])
        assert is_read(run, file) == (file == "metrics.jsonl"), size
        if file == "metrics.jsonl":
            assert read_metrics(run) == ROWS[: content[:size].count(b"\n")]


@pytest.mark.parametrize(
    "line",
    [
        *(b"x", b"[1]", b"{}", b'{"steps": null}', b"\xff", b"", b"3", b"[" * 100_000),
        *(b'{"steps": 1e999}', b'{"steps": 2, "a": "b"}', b'{"steps": 2, "a": 1%0400d}' % 0),
    ],
    ids=lambda line: line[:30],
)
def test_a_line_that_is_no_row_is_named(tmp_path: Path, line: bytes):
    rows = [json.dumps(row).encode() for row in ROWS]
    (tmp_path / "metrics.jsonl").write_bytes(b"\n".join((rows[0], line, *rows[1:], b"")))
    with pytest.raises(UserError, match=r"metrics\.jsonl, line 2: expected"):
        read_metrics(Run(tmp_path))
