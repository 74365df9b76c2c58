"""Other systems: wheels of every package for them, and nothing that only POSIX has.

The tags of the wheels in the lock are compared with what each system and Python takes. Nothing is
run on these systems here.
"""

import re
import tomllib
from urllib.parse import unquote

import pytest
from packaging.requirements import Requirement
from packaging.tags import Tag, compatible_tags, cpython_tags, mac_platforms
from packaging.utils import parse_wheel_filename

from tests.programs import ROOT, python

# Markers, and the names that wheels give the platform.
SYSTEMS = {
    "Linux arm64": (
        {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": "aarch64"},
        ["manylinux2014_aarch64", *(f"manylinux_2_{minor}_aarch64" for minor in range(17, 29))],
    ),
    "macOS arm64": (
        {"sys_platform": "darwin", "platform_system": "Darwin", "platform_machine": "arm64"},
        list(mac_platforms((13, 0), "arm64")),
    ),
    "Windows": (
        {"sys_platform": "win32", "platform_system": "Windows", "platform_machine": "AMD64"},
        ["win_amd64"],
    ),
}
# The package is imported twice: other packages once with what POSIX alone has, and ours without.
WITHOUT_POSIX = """
import importlib, multiprocessing.popen_spawn_posix, os, pkgutil, signal, sys, tempfile

def import_all():
    import quadwalk
    for module in pkgutil.walk_packages(quadwalk.__path__, "quadwalk."):
        # Not what needs an extra, and a script that is exported.
        if not module.name.endswith((".gym", ".run_policy")):
            importlib.import_module(module.name)

import_all()
for name in [name for name in sys.modules if name.partition(".")[0] == "quadwalk"]:
    del sys.modules[name]
for name in ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty"):
    sys.modules[name] = None
for module, names in (
    (os, "fork geteuid getpgid getuid killpg mkfifo sched_getaffinity setsid"),
    (signal, "SIGALRM SIGHUP SIGKILL SIGUSR1 alarm pthread_kill setitimer"),
):
    for name in names.split():
        delattr(module, name)

def main():
    import_all()
    from quadwalk.cores import get_cache_folder, count_cores
    from quadwalk.learn.loop import stop_on_signal
    from quadwalk.runs.directory import claim, create_run
    from quadwalk.runs.log import MetricsLog, read_metrics
    assert count_cores() > 0 and get_cache_folder()
    with tempfile.TemporaryDirectory() as folder:
        run = create_run(folder, "a")
        with claim(run), MetricsLog(run) as log, stop_on_signal():
            log.append({"steps": 1}, {"time/elapsed": 1.0})
        print(len(read_metrics(run)))

from quadwalk.cli.process import run_command
run_command(main)
"""


@pytest.fixture(scope="module")
def requirements() -> list[Requirement]:
    """Return what the lock installs, each with its version and its marker."""
    options = ("--frozen", "--no-hashes", "--no-emit-project", "--no-header", "--no-annotate")
    done = python("-m", "uv", "export", "--offline", *options)
    assert done.returncode == 0, done.stderr
    return [Requirement(line) for line in done.stdout.splitlines()]


@pytest.fixture(scope="module")
def wheels() -> dict[tuple[str, str], set[Tag]]:
    """Return the tags of all wheels in the lock, by package and version."""
    packages = tomllib.loads((ROOT / "uv.lock").read_text())["package"]
    tags_of: dict[tuple[str, str], set[Tag]] = {}
    for package in packages:
        for wheel in package.get("wheels", []):
            tags = parse_wheel_filename(unquote(wheel["url"].rpartition("/")[2]))[3]
            tags_of.setdefault((package["name"], package["version"]), set()).update(tags)
    return tags_of


@pytest.mark.parametrize("version", ["3.12", "3.13", "3.14"])
@pytest.mark.parametrize("system", SYSTEMS)
def test_the_lock_has_wheels(requirements, wheels, system, version):
    markers, platforms = SYSTEMS[system]
    environment = {**markers, "python_version": version, "python_full_version": f"{version}.0"}
    number = tuple(map(int, version.split(".")))
    usable = {*cpython_tags(number, platforms=platforms), *compatible_tags(number, "cp", platforms)}
    needed = [r for r in requirements if r.marker is None or r.marker.evaluate(environment)]
    assert len(needed) > 40
    pinned = [(need.name, str(need.specifier).removeprefix("==")) for need in needed]
    assert not [package for package in pinned if not usable & wheels.get(package, set())]


def test_the_lock_names_the_public_registry_alone():
    urls = re.findall(r'"(https?://[^/"]+)', (ROOT / "uv.lock").read_text())
    assert set(urls) == {"https://pypi.org", "https://files.pythonhosted.org"}


def test_nothing_needs_what_windows_lacks():
    done = python("-c", WITHOUT_POSIX)
    assert (done.returncode, done.stdout) == (0, "1\n"), done.stderr
