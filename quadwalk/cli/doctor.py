"""`quadwalk doctor`: versions, devices, cores, and what is off here."""

import importlib.metadata
import json
import platform
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from packaging.requirements import Requirement

from quadwalk.cli.arguments import parse
from quadwalk.cores import count_cores, get_cache_folder, get_instructions
from quadwalk.errors import UserError

SHOWN = ("jax", "jaxlib", "flax", "brax", "mujoco", "mujoco-mjx", "numpy")
TELLING = ("sse4_2", "avx", "avx2", "fma", "avx512f", "asimd", "sve")  # of the instruction sets
# In a process of its own: a broken package may end it, and XLA does so for a flag it does not know.
PROBE = """
import json, mujoco, mujoco.mjx, jax, brax.training
from quadwalk.render.opengl import find_working_library
from quadwalk.learn.devices import set_up_devices
set_up_devices()
print(json.dumps([[str(device) for device in jax.devices()], find_working_library()]))
"""


@dataclass(frozen=True)
class DoctorConfig:
    """Print versions, devices, cores, and what is off here."""


def main(args: Sequence[str], prog: str = "quadwalk doctor") -> None:
    """Print versions, devices and warnings; raise `UserError` where quadwalk cannot run."""
    parse(DoctorConfig, args, prog)
    versions = {name: _get_version(name) or "missing" for name in SHOWN}
    print(f"{'quadwalk':11}{_get_version('quadwalk') or 'not installed, run from its source'}")
    print(f"{'python':11}{platform.python_version()}, {sys.executable}")
    print(f"{'packages':11}{', '.join(f'{name} {version}' for name, version in versions.items())}")
    sets = [name for name in TELLING if name in get_instructions().split()]
    print(f"{'processor':11}{count_cores()} cores, {platform.machine()} {' '.join(sets)}")
    folder = get_cache_folder()
    size = sum(file.stat().st_size for file in folder.rglob("*")) if folder.is_dir() else 0
    print(f"{'cache':11}{folder}, {size / 1e6:,.0f} MB", flush=True)
    done = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True)
    messages = done.stderr.strip().splitlines()
    if done.returncode == 0:
        devices, library = json.loads(done.stdout.splitlines()[-1])
        print(f"{'devices':11}{', '.join(devices)}")
        print(f"{'pictures':11}{library or 'by ray casting: no GL library works here'}")
    for line in [
        *(line for line in messages if line.startswith("warning: ")),
        *_find_other_versions(),
    ]:
        print(line)
    if done.returncode:
        unknown = [line.partition("] ")[2] for line in messages if "Unknown flag" in line]
        reason = (unknown or messages[-1:] or [f"status {done.returncode}"])[0]
        raise UserError(f"JAX and MuJoCo do not start: {reason}")


def _get_version(name: str) -> str | None:
    """Return the installed version of a package; None if it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _find_other_versions() -> list[str]:
    """Return a warning for each package that is missing or not of a version that quadwalk requires.

    Packages of extras are left out.
    """
    lines = (importlib.metadata.requires("quadwalk") or []) if _get_version("quadwalk") else []
    warnings = []
    for need in map(Requirement, lines):
        if need.marker and not need.marker.evaluate({"extra": ""}):
            continue
        version = _get_version(need.name)
        if version is None or version not in need.specifier:
            state = f"is {version}" if version else "is missing"
            warnings.append(f"warning: {need.name} {state}; expected {need.name}{need.specifier}")
    return warnings
