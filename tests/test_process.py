"""Command lines as processes: how they end, what they print to, and what runs them."""

import os
import shlex
import shutil
import signal
import subprocess
import sys
import textwrap
import time
import venv
from pathlib import Path

import pytest

from quadwalk.cli import shell

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and shells are those of POSIX")


# How they end

PROGRAM = """
import time
from pathlib import Path
from quadwalk.files import open_atomic
from quadwalk.cli.process import run_command

def main():
{body}

run_command(main)
"""
WORK = """
with open_atomic("file"):
    print("ready", flush=True)
    time.sleep(60)
"""
LIBRARY_ERROR = f"""
try:
{textwrap.indent(WORK, "    ")}
except BaseException as error:
    raise ImportError("cannot import it") from error
"""
CALLBACK = """
import gc
def callback(phase, _):
    if phase == "start":
        print("ready", flush=True)
        time.sleep(0.5)
gc.callbacks.append(callback)
gc.collect()
gc.callbacks.clear()
time.sleep(60)
"""
CAUGHT = """
try:
    print("ready", flush=True)
    time.sleep(60)
except BaseException:
    pass
time.sleep(60)
"""
IGNORED = """
while True:
    try:
        print("ready", flush=True)
        time.sleep(60)
    except BaseException:
        pass
"""


def make_program(body: str) -> list[str]:
    """Return a command line that runs `body` as a command."""
    lines = textwrap.indent(body, "    ")
    return [sys.executable, "-c", PROGRAM.format(body=lines)]


def interrupt(
    command: list[str], folder: Path, at: str, *, number: int = signal.SIGINT, later: float = 0.0
) -> subprocess.CompletedProcess[str]:
    """Run a command, and send a signal each time it has printed `at`, `later` seconds after."""
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=(folder / "stderr").open("wb"),
        text=True,
        cwd=folder,
        start_new_session=True,
    ) as process:
        try:
            for line in process.stdout:
                if at in line:
                    time.sleep(later)
                    process.send_signal(number)
            process.wait(timeout=60)
        finally:
            process.kill()
    message = (folder / "stderr").read_text()
    (folder / "stderr").unlink()
    return subprocess.CompletedProcess(command, process.returncode, "", message)


@pytest.mark.parametrize(
    ("body", "number"),
    [
        (WORK, signal.SIGINT),
        (WORK, signal.SIGTERM),
        (LIBRARY_ERROR, signal.SIGINT),
        (CALLBACK, signal.SIGINT),
        (CAUGHT, signal.SIGINT),
    ],
)
def test_a_signal_ends_a_command_in_one_line(tmp_path, body, number):
    done = interrupt(make_program(body), tmp_path, "ready", number=number)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")
    assert os.listdir(tmp_path) == []


def test_a_second_signal_ends_what_ignores_the_first(tmp_path):
    done = interrupt(make_program(IGNORED), tmp_path, "ready")
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


def test_a_training_that_has_not_begun_leaves_nothing(tmp_path):
    command = [sys.executable, str(ROOT / "train.py"), "--name=dog", "--envs=16"]
    done = interrupt(command, tmp_path, "] loading\n", later=1.0)
    # Python ends by the signal where it came in an import; a shell calls that 130 too.
    assert done.returncode in (130, -signal.SIGINT)
    assert done.stderr == "interrupted\n"
    assert not list(tmp_path.glob("runs/*"))


def test_an_evaluation_is_interrupted_in_one_line(tmp_path):
    command = f"exec {sys.executable} {ROOT / 'eval.py'} walk 2>&1"
    done = interrupt(["sh", "-c", command], tmp_path, "evaluating", later=0.5)
    assert done.returncode == 130
    assert not list(tmp_path.rglob("*.*"))


# What they print to

FULL = "error: cannot write to standard output: No space left on device\n"
PLAIN = {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


@pytest.mark.parametrize(
    ("body", "to", "status", "stdout", "stderr"),
    [
        (r"print('\xb1')", "", 0, "?\n", ""),
        ("print('x')", "> /dev/full", 1, "", FULL),
        ("print('x' * 10**6)", "> /dev/full", 1, "", FULL),
        ("print('x' * 10**6)", "| true", 1, "", ""),
        ("pass", ">&- <&-", 0, "", ""),
        ("raise __import__('quadwalk.errors').errors.UsageError('x')", "", 2, "", "error: x\n"),
    ],
)
def test_what_takes_no_text_is_one_line_at_most(body, to, status, stdout, stderr):
    line = f"set -o pipefail; {shlex.join(make_program(body))} {to}"
    environment = {**os.environ, **PLAIN}
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stdout, done.stderr) == (status, stdout, stderr)


# What runs them


@pytest.fixture
def checkout(tmp_path, monkeypatch) -> Path:
    """Make a checkout; in the shell, `python` is that of an environment without packages."""
    folder = tmp_path / "my checkout"
    folder.mkdir()
    for name in ("quadwalk", "assets", "Makefile", "tools", "uv.lock", "pyproject.toml"):
        (folder / name).symlink_to(ROOT / name)
    for name in ("train.py", "eval.py"):  # where a link leads, Python looks for packages
        shutil.copy(ROOT / name, folder)
    venv.create(tmp_path / "bare", symlinks=True)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bare/bin'}:/usr/bin:/bin")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    return folder


def run_line(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True)


def make_venv(folder: Path, interpreter: str) -> None:
    """Make a .venv whose Python is `interpreter`."""
    python = folder / ".venv/bin/python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\nexec {interpreter} "$@"\n')
    python.chmod(0o755)


@pytest.mark.parametrize("script", ["train.py", "eval.py", "-m quadwalk export"])
def test_the_environment_beside_a_script_is_found(checkout, script):
    make_venv(checkout, f"env PYTHONPATH='{checkout}' {sys.executable}")
    done = run_line(f"python {script} --nonsense", checkout)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: unknown option --nonsense")
    assert done.stderr.count("\n") == 1


def test_without_packages_one_line_says_how_to_get_them(checkout):
    done = run_line("python train.py", checkout)
    assert done.returncode == 1
    assert done.stderr == (
        "error: jax is not installed; get what is needed by: make setup, or: "
        "python -m pip install -e .\n"
    )
    done = run_line("cd .. && python 'my checkout/eval.py'", checkout)
    commands = done.stderr.strip().partition("by: ")[2].split(", or: ")
    dry_run = run_line(f"cd .. && {commands[0]} -n", checkout)
    assert "tools/uv sync" in dry_run.stdout
    assert (checkout.parent / shlex.split(commands[1])[-1]).samefile(checkout)


@pytest.mark.parametrize(
    ("called", "on_path", "expected"),
    [
        ("bin/quadwalk", True, "quadwalk eval 'a b'"),
        ("bin/quadwalk", False, "bin/quadwalk eval 'a b'"),
        ("train.py", True, "python eval.py 'a b'"),
        ("train.py", False, "bin/python eval.py 'a b'"),
        ("./train.py", True, "python eval.py 'a b'"),
        ("other/train.py", True, "python -m quadwalk eval 'a b'"),
        ("", True, "python eval.py 'a b'"),
    ],
)
def test_a_command_is_named_so_that_this_shell_finds_it(
    tmp_path, monkeypatch, called, on_path, expected
):
    for name in ("bin/quadwalk", "bin/python", "train.py", "eval.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(shell, "ROOT", tmp_path)
    monkeypatch.setattr("sys.argv", [called])
    monkeypatch.setattr("sys.executable", str(tmp_path / "bin/python"))
    monkeypatch.setenv("PATH", str(tmp_path / "bin") if on_path else "/nowhere")
    assert shell.make_command("eval", "a b") == expected


@pytest.mark.parametrize(
    ("there", "path", "expected"),
    [
        (["bin/rerun", "other/rerun"], "other", "bin/rerun"),  # that of this Python comes first
        (["bin/rerun"], "bin", "rerun"),
        (["other/rerun"], "other", "rerun"),
        ([], "other", "bin/rerun"),  # where pip would put it
    ],
)
def test_a_program_beside_this_python_is_found(tmp_path, monkeypatch, there, path, expected):
    for name in ("bin", "other"):
        (tmp_path / name).mkdir()
    for name in there:
        (tmp_path / name).touch(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.executable", str(tmp_path / "bin/python"))
    monkeypatch.setenv("PATH", str(tmp_path / path))
    assert shell.find_program("rerun") == expected
