"""quadwalk: teach a quadruped to run, on an ordinary CPU, in minutes.

import quadwalk

env = quadwalk.make("walk", robot="go1.urdf")
run = quadwalk.train("run", steps=4_000_000, overrides={"env.reward.energy": -0.5})
result = quadwalk.evaluate(run, episodes=64, engine="mujoco")
"""

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

import quadwalk.command.quiet  # noqa: F401

if TYPE_CHECKING:
    from quadwalk.api import compare, evaluate, load_policy, make, train

__version__ = "0.2.0"
__all__ = ["compare", "evaluate", "load_policy", "make", "train"]


def __getattr__(name: str) -> Any:
    """Import what a notebook needs when it is first used: JAX takes a second."""
    if name in __all__:
        from quadwalk import api

        return getattr(api, name)
    raise AttributeError(f"module 'quadwalk' has no attribute {name!r}")


class _Callable(ModuleType):
    """A package of the same name as a function of `quadwalk.api`: called, it is that function."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return __getattr__(self.__name__.rpartition(".")[2])(*args, **kwargs)


class _Quadwalk(ModuleType):
    """Python sets a package in the place of the function when anything in it is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in __all__ and isinstance(value, ModuleType):
            value.__class__ = _Callable
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Quadwalk
