"""Names of terms in files: none twice, none missing, and those of earlier versions are read."""

import importlib
import inspect
import json
import pkgutil
import re
from pathlib import Path

import pytest

import quadwalk.tasks
from quadwalk.env import rewards as reward
from quadwalk.env import terminations as termination
from quadwalk.paths import PRETRAINED
from quadwalk.runs import checkpoint
from quadwalk.settings.registry import (
    ALIASES,
    TERMS,
    find_term,
    get_term_name,
    to_current_name,
)
from quadwalk.settings.serialize import from_dict, to_dict
from quadwalk.settings.training import TrainConfig
from quadwalk.task_files import load_task

# A config.json as training wrote it when files named modules.
OLD_CONFIG = Path(__file__).with_name("config_with_module_names.json")
# What a kind of term is called with.
INPUTS = {
    "reward": ["robot", "step"],
    "observation": ["robot", "state"],
    "termination": ["robot", "step"],
    "action": ["robot", "action"],
}
MODULES = ("rewards", "observations", "terminations", "actions")


def names_in(text: str) -> set[str]:
    """Return the terms that the text of a file names."""
    return set(re.findall(r'"function": "([^"]+)"', text))


def to_module_names(text: str) -> str:
    """Return the text of a file as versions without registered names wrote it."""
    single = {old: new for old, new in ALIASES.items() if ":" in old}
    for old, new in single.items():
        text = text.replace(f'"{new}"', f'"{old}"')
    for module, kind in ALIASES.items() - single.items():
        text = text.replace(f'"{kind}:', f'"{module}:')
    return text


def test_no_function_has_two_names():
    assert len(set(TERMS.values())) == len(TERMS)


@pytest.mark.parametrize("name", TERMS)
def test_a_name_is_of_a_term_of_its_kind_and_comes_back(name):
    function = find_term(name, Path())
    assert get_term_name(function) == name
    parameters = inspect.signature(function).parameters.values()
    inputs = [p.name for p in parameters if p.kind is not p.KEYWORD_ONLY]
    # An action map may ask for the joints' angles too.
    joints = ["joints"] if name == "action:between_bounds" else []
    assert inputs == [*INPUTS[name.partition(":")[0]], *joints]


def test_every_term_of_the_package_has_a_name():
    modules = [f"quadwalk.env.{name}" for name in MODULES]
    modules += [
        f"quadwalk.tasks.{module.name}" for module in pkgutil.iter_modules(quadwalk.tasks.__path__)
    ]
    places = set()
    for module in modules:
        for name, item in vars(importlib.import_module(module)).items():
            if inspect.isfunction(item) and item.__module__ == module and name[0] != "_":
                inputs = list(inspect.signature(item).parameters)
                if any(inputs[: len(start)] == start for start in INPUTS.values()):
                    places.add(f"{module}:{name}")
    assert places == {f"{term.__module__}:{term.__name__}" for term in TERMS.values()}


def test_a_name_of_an_earlier_version_is_that_of_the_same_term():
    for old, new in ALIASES.items():
        if ":" in old:
            assert new in TERMS, old
    # Both are called offset and heading, and are other terms.
    assert to_current_name("quadwalk.task.reward:offset") == "reward:offset"
    assert to_current_name("quadwalk.task.observation:offset") == "observation:offset"
    assert to_current_name("quadwalk.tasks.blog:heading") == "reward:heading"
    assert to_current_name("quadwalk.task.observation:heading") == "observation:heading"
    assert to_current_name("quadwalk.task.observation:joint_positions") == "observation:joint_pos"
    assert to_current_name("task.py:heading") == "task.py:heading"


def test_the_configuration_of_an_earlier_run_is_read_and_written_by_registered_names():
    text = OLD_CONFIG.read_text()
    assert len(names_in(text)) > 20
    assert all(name.startswith("quadwalk.task") for name in names_in(text))
    config = from_dict(TrainConfig, json.loads(text)["config"], Path())
    assert config.env.reward["energy"].function is reward.energy
    assert config.env.termination["tipped"].function is termination.tipped
    terms = {name: term.function for name, term in load_task("walk").env.reward.items()}
    del terms["feet_behind"]  # which that run did not have
    assert {name: term.function for name, term in config.env.reward.items()} == terms
    written = names_in(json.dumps(to_dict(config)))
    assert written <= set(TERMS)
    assert len(written) == len(names_in(text))
    assert names_in(to_module_names(json.dumps(to_dict(config)))) == names_in(text)


@pytest.mark.parametrize("run", sorted(path.name for path in PRETRAINED.iterdir()))
def test_every_term_of_a_packaged_policy_is_known(run):
    _, metadata = checkpoint.load(PRETRAINED / run / "policy.npz", "policy")
    names = names_in(json.dumps(metadata["config"]))
    assert len(names) > 10
    assert {to_current_name(name) for name in names} <= set(TERMS)
