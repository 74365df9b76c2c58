"""Other systems: wheels of every package for them, and nothing that only POSIX has.

The lock is resolved for each system and Python with wheels alone; nothing is run on them here.
"""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SYSTEMS = {
    "Linux arm64": "aarch64-unknown-linux-gnu",
    "macOS arm64": "aarch64-apple-darwin",
    "Windows": "x86_64-pc-windows-msvc",
}
PYTHONS = ("3.12", "3.13", "3.14")
# Of these the module or name is missing on Windows. What others import has it by then.
WITHOUT_POSIX = """
import importlib, os, pkgutil, signal, sys, tempfile
from quadwalk.command.process import _PACKAGES, run_command
for name in (*_PACKAGES, "mujoco.mjx", "brax.training", "multiprocessing.popen_spawn_posix"):
    importlib.import_module(name)
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
    import quadwalk
    for module in pkgutil.walk_packages(quadwalk.__path__, "quadwalk."):
        # Not commands, what needs an extra, and a script that is exported.
        if not module.name.endswith(("__main__", ".gym", ".run_policy")):
            importlib.import_module(module.name)
    from quadwalk.cores import compilation_cache, cpu_cores
    from quadwalk.train.loop import stop_on_signal
    from quadwalk.train.runs.directory import claim, create_run
    from quadwalk.train.runs.log import MetricsLog, read_metrics
    assert cpu_cores() > 0 and compilation_cache()
    with tempfile.TemporaryDirectory() as folder:
        run = create_run(folder, "a")
        with claim(run), MetricsLog(run) as log, stop_on_signal():
            log.append({"steps": 1}, {"time/elapsed": 1.0})
        print(len(read_metrics(run)))

from quadwalk.command.process import run_command
run_command(main)
"""


def resolve(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--no-config"]
    command += ["--only-binary", ":all:", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT)


@pytest.fixture(scope="module")
def registry(tmp_path_factory) -> None:
    """Skip where no registry of packages answers."""
    wanted = tmp_path_factory.mktemp("uv") / "requirements.in"
    wanted.write_text("packaging\n")
    done = resolve("--no-cache", str(wanted))
    if done.returncode:
        pytest.skip(f"no registry of packages: {done.stderr.strip().splitlines()[-1]}")


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("system", SYSTEMS)
def test_the_lock_has_wheels(registry, system, python):
    done = resolve(
        "requirements.lock", "--python-platform", SYSTEMS[system], "--python-version", python
    )
    assert done.returncode == 0, done.stderr
    assert "mujoco==" in done.stdout


def test_nothing_needs_what_windows_lacks():
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_POSIX], capture_output=True, text=True, cwd=ROOT
    )
    assert (done.returncode, done.stdout) == (0, "1\n"), done.stderr
