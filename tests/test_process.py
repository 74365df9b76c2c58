"""Command lines as processes: how they end, what they print to, and what runs them."""

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
import venv
from pathlib import Path

import pytest

from quadwalk.cli import shell
from quadwalk.cli.process import _PACKAGES
from tests.test_layers import imports

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and shells are those of POSIX")


# How they end

WAYS = {
    "Python": "ready(); time.sleep(60)",
    "exec": "ready(); exec('time.sleep(60)')",
    "an error of a library": """
try:
    ready(); time.sleep(60)
except BaseException as error:
    raise ImportError("cannot import it") from error
""",
    "the garbage collector": """
gc.callbacks.append(lambda *_: (ready(), time.sleep(0.5)))
gc.collect()
gc.callbacks.clear()
time.sleep(60)
""",
    "a library that ignores it": """
ready()
while True:
    try:
        time.sleep(60)
    except BaseException:
        pass
""",
    # Its enumerations are made by Python's from C++, which aborts where that raises.
    "the import of a compiled module": """
make = enum.EnumType.__init__
def slowly(*args, **kwargs):
    ready()
    time.sleep(0.2)
    make(*args, **kwargs)
enum.EnumType.__init__ = slowly
import jaxlib._jax
time.sleep(60)
""",
    # No exception enters what is computed in C for minutes.
    "C": """
with atomic_write("file"), unfinished(Path("folder")):
    Path("folder/in").mkdir(parents=True)
    ready()
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
""",
}
IMPORTS = """
import enum, gc, hashlib, time
from pathlib import Path
from quadwalk.files import atomic_write, unfinished
from quadwalk.cli.process import run_command

def ready():
    print("ready", flush=True)
"""


def program(content: str) -> list[str]:
    """A command line that does this."""
    body = "\n".join(f"    {line}" for line in content.strip().splitlines())
    return [sys.executable, "-c", f"{IMPORTS}\ndef main():\n{body}\nrun_command(main)"]


def interrupted(command: list[str], folder: Path, at: str, number: int, later: float = 0) -> str:
    """What it says on stderr when a signal comes, some seconds after it has printed `at`."""
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=(folder / "stderr").open("wb"),
        text=True,
        cwd=folder,
        start_new_session=True,
    ) as process:
        for line in process.stdout:
            if at in line:
                break
        time.sleep(later)
        # A terminal sends Ctrl-C to the children too.
        (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
        try:
            process.communicate(timeout=60)
        finally:
            process.kill()
    said = (folder / "stderr").read_text()
    assert process.returncode == 128 + number, said
    (folder / "stderr").unlink()
    return said


@pytest.mark.parametrize(
    ("way", "number"),
    [*((way, signal.SIGINT) for way in WAYS), ("Python", signal.SIGTERM), ("C", signal.SIGTERM)],
)
def test_a_signal_ends_a_command_whatever_it_is_at(tmp_path, way, number):
    said = {signal.SIGINT: "interrupted\n", signal.SIGTERM: "terminated\n"}[number]
    assert interrupted(program(WAYS[way]), tmp_path, "ready", number) == said
    assert os.listdir(tmp_path) == []


POOL = """
import multiprocessing, time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from quadwalk.cli.process import run_command
from quadwalk.learn.loop import stop_on_signal

def train():
    with stop_on_signal() as stop:
        print("ready", flush=True)
        while not stop.is_set():  # whose wait() cannot be set from a signal's handler at any time
            time.sleep(0.01)
        time.sleep(3)
        Path("saved").touch()
    raise KeyboardInterrupt

def main():
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        pool.submit(train).result()

if __name__ == "__main__":
    run_command(main)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_children_save_what_they_train(tmp_path, number):
    (tmp_path / "pool.py").write_text(POOL)
    interrupted([sys.executable, "pool.py"], tmp_path, "ready", number)
    assert sorted(os.listdir(tmp_path)) == ["pool.py", "saved"]


@pytest.mark.parametrize(("phase", "later"), [("loading", 1.5), ("compiling", 1.0)])
def test_a_training_that_has_not_begun_leaves_nothing(tmp_path, phase, later):
    command = [sys.executable, str(ROOT / "train.py"), "--name=dog"]
    said = interrupted(command, tmp_path, phase, signal.SIGINT, later)
    assert said == "interrupted\n"
    assert not list(tmp_path.glob("runs/*"))


def test_an_evaluation_is_interrupted_in_one_line(tmp_path):
    command = f"{sys.executable} {ROOT / 'eval.py'} walk 2>&1"
    said = interrupted(["sh", "-c", f"exec {command}"], tmp_path, "evaluating", signal.SIGINT, 0.5)
    assert said == ""
    assert not list(tmp_path.rglob("*.*"))


# What they print to

REFUSED = "cannot write to standard output"
PLAIN = {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


@pytest.mark.parametrize(
    ("content", "to", "status", "said"),
    [
        (r"print('\xb1')", "", 0, ""),
        ("print('x')", "> /dev/full", 1, f"{REFUSED}: No space left on device"),
        ("print('x' * 10**6)", "> /dev/full", 1, f"{REFUSED}: No space left on device"),
        ("raise SystemExit(print('x'))", "> /dev/full", 1, f"{REFUSED}: No space left on device"),
        ("print('x')", ">&-", 1, f"{REFUSED}: Bad file descriptor"),
        ("pass", ">&- <&-", 0, ""),
        ("print('x' * 10**6)", "| true", 1, ""),
        ("raise __import__('quadwalk.errors').errors.UsageError('x')", "2>&-", 2, ""),
        ("raise __import__('quadwalk.errors').errors.UsageError('x')", "2> /dev/full", 2, ""),
        ("print('x', file=__import__('sys').stderr)", "2> /dev/full", 0, ""),
    ],
)
def test_what_takes_no_text_is_one_line_at_most(content, to, status, said):
    line = f"set -o pipefail; {shlex.join(program(content))} {to}"
    environment = {**os.environ, **PLAIN}
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, env=environment)
    assert done.returncode == status, done.stderr
    assert done.stdout == ("?\n" if "xb1" in content else "")
    assert said in done.stderr
    assert done.stderr.count("\n") == bool(said)


def test_a_closed_stream_is_not_the_file_that_is_written(tmp_path):
    content = "with atomic_write('file') as file:\n    __import__('os').system('echo x')"
    line = f"{shlex.join(program(content))} >&-"
    subprocess.run(["sh", "-c", line], cwd=tmp_path, check=True, stderr=subprocess.DEVNULL)
    assert (tmp_path / "file").read_bytes() == b""


# What runs them


@pytest.fixture
def checkout(tmp_path, monkeypatch) -> Path:
    """A checkout, and `python` of an environment without packages in the shell."""
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


def pasted(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True)


def make_venv(folder: Path, interpreter: str) -> None:
    """A .venv whose Python is `interpreter`."""
    python = folder / ".venv/bin/python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\nexec {interpreter} "$@"\n')
    python.chmod(0o755)


@pytest.mark.parametrize("script", ["train.py", "eval.py", "-m quadwalk export"])
def test_the_environment_beside_a_script_is_found(checkout, script):
    make_venv(checkout, f"env PYTHONPATH='{checkout}' {sys.executable}")
    done = pasted(f"python {script} --nonsense", checkout)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: unknown option --nonsense")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("empty", [True, False])
def test_without_packages_one_line_says_how_to_get_them(checkout, empty):
    if empty:
        make_venv(checkout, "python")
    done = pasted("python train.py", checkout)
    assert done.returncode == 1
    assert done.stderr == (
        "error: PIL is not installed; get what is needed by: make setup, or: "
        "python -m pip install -e .\n"
    )
    done = pasted("cd .. && python 'my checkout/eval.py'", checkout)
    commands = done.stderr.strip().partition("by: ")[2].split(", or: ")
    made = pasted(f"cd .. && {commands[0]} -n", checkout)
    assert "tools/uv sync" in made.stdout
    assert (checkout.parent / shlex.split(commands[1])[-1]).samefile(checkout)


def test_what_is_imported_is_what_is_looked_for():
    extras = {
        *("glfw", "gymnasium", "imageio_ffmpeg", "mjviser", "onnx", "onnxruntime", "viser"),
        *("optuna", "sqlalchemy", "ray", "wandb"),
        "controller",  # an export's, beside run_policy.py
    }
    found = {name.partition(".")[0] for names in imports().values() for name in names}
    assert set(_PACKAGES) == found - extras - set(sys.stdlib_module_names) - {"quadwalk"}


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
    assert shell.as_typed("eval", "a b") == expected
