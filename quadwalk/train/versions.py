"""Versions of what a run's numbers depend on."""

import importlib.metadata
import platform


def versions() -> dict[str, str]:
    """Package name to version, of Python and the packages that compute."""
    packages = ("quadwalk", "mujoco", "mujoco-mjx", "jax", "jaxlib", "brax", "flax", "optax")
    found = {name: importlib.metadata.version(name) for name in packages}
    return {"python": platform.python_version(), **found}
