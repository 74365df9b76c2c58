"""The URDFs of PyPI's example-robot-data, its quadrupeds among them."""

from pathlib import Path

import pytest

from benchmarks.shared import find_example_robots

FOLDER = find_example_robots()
assert FOLDER, "example-robot-data is not installed; expected it: pip install -e '.[test]'"
FILES = sorted(FOLDER.rglob("*.urdf"))
# By their folder: whether the knees of the hind legs point ahead.
KNEES_AHEAD = {
    "a1_description": False,
    "anymal_b_simple_description": True,
    "anymal_c_simple_description": True,
    "b1_description": False,
    "go1_description": False,
    "go2_description": False,
    "hyq_description": True,
    "laikago_description": False,
    "solo_description": False,
}
QUADRUPEDS = [
    file
    for file in FILES
    if file.parts[-3] in KNEES_AHEAD and file.stem not in ("anymal-kinova", "b1-z1", "solo")
]


def repeat_for(files: list[Path], *names: str) -> pytest.MarkDecorator:
    """Return a mark that runs a test once for each of `files`, which it gets as `urdf`.

    With `names` only those count whose path has one in it.
    """
    selection = [file for file in files if not names or any(name in str(file) for name in names)]
    assert len(selection) >= len(names)
    return pytest.mark.parametrize(
        "urdf", selection, ids=[str(f.relative_to(FOLDER)) for f in selection]
    )
