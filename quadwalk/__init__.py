"""quadwalk: teach a quadruped to run, on an ordinary CPU, in minutes.

import quadwalk

env = quadwalk.make("walk", robot="go1.urdf")
run = quadwalk.train("run", steps=4_000_000, overrides={"env.reward.energy": -0.5})
result = quadwalk.evaluate(run, episodes=64, engine="mujoco")
"""

from types import ModuleType
from typing import TYPE_CHECKING, Any

import quadwalk.quiet  # noqa: F401

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


class CallablePackage(ModuleType):
    """The class of a package of the same name as a function of `quadwalk`.

    Python puts a package in its parent's namespace when anything in it is imported, in the place of
    the function. So that `quadwalk.train(...)` works before and after, calling it calls that.
    """

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """The function of `quadwalk.api`, which has its arguments."""
        return __getattr__(self.__name__.rpartition(".")[2])(*args, **kwargs)
