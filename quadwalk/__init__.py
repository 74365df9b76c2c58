"""quadwalk: teach a quadruped to run, on an ordinary CPU, in minutes.

import quadwalk

env = quadwalk.make("walk", robot="go1.urdf")
run = quadwalk.train("run", steps=4_000_000, overrides={"env.reward.energy": -0.5})
result = quadwalk.evaluate(run, episodes=64, engine="mujoco")
"""

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from quadwalk.api import compare, evaluate, load_policy, make, play, train

# XLA would print a page about its tuning hints each time it reads a compiled program from the
# cache. JAX reads this when it is imported.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

__version__ = "0.2.0"
__all__ = ["compare", "evaluate", "load_policy", "make", "play", "train"]


def __getattr__(name: str) -> Any:
    """Import what a notebook needs when it is first used: JAX takes a second."""
    if name in __all__:
        from quadwalk import api

        return getattr(api, name)
    raise AttributeError(f"module 'quadwalk' has no attribute {name!r}")
