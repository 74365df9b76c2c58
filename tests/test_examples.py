"""Examples in Python on pages, executed as they stand, each page's in one namespace."""

import re
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).parents[1] / "docs"
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)


def run_examples(page: str) -> dict:
    """Execute the blocks of a page one after the other; return the names that they define."""
    names: dict = {"__name__": "__main__"}
    for block in BLOCK.findall((DOCS / page).read_text()):
        exec(compile(block, page, "exec"), names)
    return names


def test_those_of_the_physics_step_robots(quadruped):
    names = run_examples("physics.md")
    assert names["physics"].qpos.shape == (4096, 19)
    heights = np.asarray(names["physics"].qpos[:, 2])
    # A control step from the home pose: robots stand, and heavier ones sink more.
    assert np.abs(heights - quadruped.home[2]).max() < 0.01
    assert heights[0] > heights[-1]
    assert np.all(np.diff(names["three"].qpos[:, 2]) < 0)


def test_those_of_gymnasium_step_environments():
    pytest.importorskip("gymnasium")
    names = run_examples("gymnasium.md")
    assert names["env"].observation_space.contains(names["observation"])
    assert np.isfinite(names["reward"])
    assert names["envs"].num_envs == 1024
