"""Imported before all others: mutes what libraries print at import; errors are exceptions."""

import contextlib
import io
import os
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

# On each hit of the compilation cache XLA prints a page about its own tuning hints; JAX reads this
# when it is imported.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

_LOUD = "mujoco.mjx.warp"  # an optional back end of MJX, which prints that it is not installed


class _Quiet:
    """Finds `_LOUD` for whoever imports it, as Brax does, and runs it without its output."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name == _LOUD else None
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def quietly(module: ModuleType) -> None:
            with contextlib.redirect_stdout(io.StringIO()):
                execute(module)

        spec.loader.exec_module = quietly  # type: ignore[method-assign]
        return spec


sys.meta_path.insert(0, _Quiet)
