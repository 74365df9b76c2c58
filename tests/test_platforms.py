"""Other systems: wheels of every package for them, and nothing that only POSIX has.

The lock is resolved for each system and Python with wheels alone; nothing is run on them here.
"""

import itertools
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.programs import ROOT, python

SYSTEMS = {
    "Linux arm64": "aarch64-unknown-linux-gnu",
    "macOS arm64": "aarch64-apple-darwin",
    "Windows": "x86_64-pc-windows-msvc",
}
PYTHONS = ("3.12", "3.13", "3.14")
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


def resolve(*arguments: object) -> subprocess.CompletedProcess[str]:
    options = ("--quiet", "--no-config", "--only-binary", ":all:")
    return python("-m", "uv", "pip", "compile", *options, *arguments)


@pytest.fixture(scope="module")
def resolved(tmp_path_factory) -> dict[tuple[str, str], subprocess.CompletedProcess[str]]:
    """The lock, resolved for all at once, for each waits; skips where no registry answers."""
    wanted = tmp_path_factory.mktemp("uv") / "requirements.in"
    wanted.write_text("packaging\n")
    done = resolve("--no-cache", wanted)
    if done.returncode:
        pytest.skip(f"no registry of packages: {done.stderr.strip().splitlines()[-1]}")

    lock = wanted.with_name("lock.txt")
    options = ("--frozen", "--no-hashes", "--no-emit-project", "--output-file", lock)
    python("-m", "uv", "export", *options).check_returncode()

    def of(place: tuple[str, str]) -> subprocess.CompletedProcess[str]:
        platform = ("--python-platform", SYSTEMS[place[0]], "--python-version", place[1])
        return resolve(lock, *platform)

    places = list(itertools.product(SYSTEMS, PYTHONS))
    with ThreadPoolExecutor(len(places)) as pool:
        return dict(zip(places, pool.map(of, places), strict=True))


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("system", SYSTEMS)
def test_the_lock_has_wheels(resolved, system, python):
    done = resolved[system, python]
    assert done.returncode == 0, done.stderr
    assert "mujoco==" in done.stdout


def test_the_lock_names_the_public_registry_alone():
    urls = re.findall(r'"(https?://[^/"]+)', (ROOT / "uv.lock").read_text())
    assert set(urls) == {"https://pypi.org", "https://files.pythonhosted.org"}


def test_nothing_needs_what_windows_lacks():
    done = python("-c", WITHOUT_POSIX)
    assert (done.returncode, done.stdout) == (0, "1\n"), done.stderr
