"""What can be driven: runs, policies, checkpoints."""

import numpy as np
import pytest

from quadwalk.errors import UserError
from quadwalk.learn.acting import load_checkpoint_policy, load_policy
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run
from quadwalk.view.choices import choose_policy, label_of, open_run, policy_choices, run_choices


def test_the_policies_of_a_run(runs):
    assert list(policy_choices(Run(runs / "dog"))) == ["last", "3 steps"]
    assert list(policy_choices(Run(runs / "cat"))) == ["last", "best"]


def test_the_runs_and_one_from_elsewhere(runs, tmp_path):
    choices = run_choices(runs, Run(runs / "dog"))
    own = {"dog", "cat", "hare", "goat"}
    assert set(choices) == own | {f"{path.name} (packaged)" for path in PRETRAINED.iterdir()}
    assert choices["drive (packaged)"].path == PRETRAINED / "drive"
    elsewhere = Run(tmp_path / "dog")
    assert next(iter(run_choices(runs, elsewhere))) == str(elsewhere.path)
    assert label_of(runs, elsewhere) == str(elsewhere.path)


def test_a_checkpoint_has_the_policy_that_was_saved_with_it(runs, walk_env):
    run, joints = Run(runs / "dog"), walk_env.quadruped.joints
    saved, found = load_policy(run.policy), load_checkpoint_policy(run.locate_checkpoint(3), joints)
    seen = np.random.default_rng(0).normal(size=(5, walk_env.observation_size)).astype(np.float32)
    assert np.array_equal(saved.act(seen), found.act(seen))
    assert (found.steps, found.observation_size) == (3, walk_env.policy_size)


def test_a_checkpoint_drives(runs):
    loaded = open_run(Run(runs / "dog"), "3 steps")
    assert loaded.file.name == "step_000000000003.npz"
    assert loaded.env.engine == "mujoco"
    assert open_run(Run(runs / "cat"), "best").policy.steps == 5


def test_a_policy_that_is_not_there_is_one_line(runs):
    with pytest.raises(UserError, match="dog has no best policy yet"):
        choose_policy(Run(runs / "dog"), "best")
