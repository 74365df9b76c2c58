"""`tools/uv`: the Python and the uv that it takes, on machines made of fake programs."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.programs import ROOT

SYSTEM = ("cat", "cp", "dirname", "grep", "mkdir", "sed", "sh", "sort", "tail")
# Prints what it is called with, and with which Python. It fetches a Python if FETCHED names one.
UV = """#!/bin/sh
case "$*" in
"python dir") ;;
"python install"*) test -n "$FETCHED" && mkdir -p "$FETCHED" && cp "$0.python" "$FETCHED/python3" ;;
*) echo "$0|$UV_PYTHON|$*" ;;
esac
"""
# Answers as an interpreter does: to the question whether it suits, and to `-m venv`.
PYTHON = """#!/bin/sh
case "$1 $2" in
"-c "*) test -n "{suits}" && echo "$0" ;;
"-m venv") test -n "{pip}" && mkdir -p "$3/bin" && cp "{pip}" "$3/bin/pip" ;;
esac
"""
PIP = """#!/bin/sh
echo "pip $*" >&2
cp "{uv}" "${{0%/pip}}/uv"
"""


class Machine:
    """A home, a PATH and a checkout, all empty but for what every system has."""

    def __init__(self, folder: Path):
        self.home = folder / "home"
        self.bin = folder / "bin"
        self.checkout = folder / "my checkout"
        self.store = folder / "store"
        for place in (self.home, self.bin, self.checkout / "tools", self.store):
            place.mkdir(parents=True)
        shutil.copy(ROOT / "tools/uv", self.checkout / "tools")
        for name in SYSTEM:
            (self.bin / name).symlink_to(shutil.which(name))
        self.add(self.bin / "uname", "#!/bin/sh\necho Darwin\n")
        self.add(self.store / "uv", UV)
        self.add(self.store / "pip", PIP.format(uv=self.store / "uv"))

    def add(self, path: Path, text: str) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        path.chmod(0o755)
        return path

    def add_python(self, path: Path, suits: bool = True, venv: bool = True) -> Path:
        pip = self.store / "pip" if venv else ""
        return self.add(path, PYTHON.format(suits="yes" if suits else "", pip=pip))

    def add_uv(self) -> Path:
        return self.add(self.bin / "uv", UV)

    def run(self, **variables: str) -> subprocess.CompletedProcess[str]:
        variables.update(HOME=str(self.home), PATH=str(self.bin))
        variables["HOMEBREW_PREFIX"] = str(self.home / "brew")
        command = [str(self.bin / "sh"), str(self.checkout / "tools/uv"), "sync", "--locked"]
        return subprocess.run(command, env=variables, capture_output=True, text=True)

    def run_for_python(self, **variables: str) -> str:
        """Run `tools/uv`; return the Python that uv was called with."""
        done = self.run(**variables)
        assert (done.returncode, done.stderr) == (0, "")
        _, python, arguments = done.stdout.strip().split("|")
        assert arguments == "sync --locked"
        return python


@pytest.fixture(name="machine")
def make_machine(tmp_path) -> Machine:
    return Machine(tmp_path)


@pytest.mark.parametrize(
    "place",
    [
        "../bin/python3.12",
        "../bin/python",
        "../my checkout/.venv/bin/python",
        ".pyenv/versions/3.13.0/bin/python3",
        ".local/share/uv/python/cpython-3.14.1-linux-x86_64-gnu/bin/python3",
        "brew/opt/python@3.12/bin/python3.12",
        "miniforge3/bin/python3",
        "anaconda3/bin/python3",
        "some where/env/bin/python3",
    ],
)
def test_a_python_that_suits_is_found_beside_an_old_one(machine, place):
    machine.add_uv()
    machine.add_python(machine.bin / "python3", suits=False)
    path = machine.add_python(machine.home / place)
    if "env" in path.parts:
        machine.add(machine.home / ".conda/environments.txt", f"/none\n{path.parents[1]}\n")
    assert (machine.checkout / machine.run_for_python()).samefile(path)


def test_a_shim_of_pyenv_that_leads_nowhere_is_passed_over(machine):
    for name in ("uv", "python3.13"):
        machine.add(
            machine.bin / name, f"#!/bin/sh\necho 'pyenv: {name}: not found' >&2\nexit 127\n"
        )
    path = machine.add_python(machine.home / ".pyenv/versions/3.13.0/bin/python3")
    done = machine.run()
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f".uv/bin/uv|{path}|sync --locked\n"


def test_the_one_that_is_named_is_taken_or_refused(machine):
    machine.add_uv()
    machine.add_python(machine.bin / "python3.13")
    path = machine.add_python(machine.home / "python")
    assert machine.run_for_python(PYTHON=str(path)) == str(path)
    machine.add_python(path, suits=False)
    done = machine.run(PYTHON=str(path))
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"error: PYTHON={path}: expected a Python 3.12, 3.13 or 3.14\n"


def test_uv_comes_from_the_registry_by_any_python_with_venv(machine):
    machine.add_python(machine.bin / "python3.13", venv=False)
    machine.add_python(machine.bin / "python3", suits=False)
    for _ in range(2):
        done = machine.run()
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith(".uv/bin/uv|")
    assert os.access(machine.checkout / ".uv/bin/uv", os.X_OK)


def test_uv_fetches_a_python_and_one_line_says_so(machine):
    uv = machine.add_uv()
    machine.add_python(machine.bin / "python3", suits=False)
    machine.add_python(uv.with_name("uv.python"))
    folder = machine.home / ".local/share/uv/python/cpython-3.13.9/bin"
    done = machine.run(FETCHED=str(folder))
    assert done.stderr == "found no Python 3.12, 3.13 or 3.14: uv fetches one\n"
    assert done.stdout == f"{uv}|{folder}/python3|sync --locked\n"


PYTHON_ORG = "get Python 3.13 from https://www.python.org/downloads"


@pytest.mark.parametrize(
    ("kernel", "release", "packages", "without_uv", "with_uv"),
    [
        ("Darwin", "", "", "brew install python@3.13", "brew install python@3.13"),
        ("Linux", "fedora", "", "sudo dnf install python3.13", "sudo dnf install python3.13"),
        ("Linux", "arch", "", PYTHON_ORG, PYTHON_ORG),
        ("Linux", "debian", "3.12 3.13", *["sudo apt install python3.13-venv"] * 2),
        ("Linux", "debian", "3.11", "sudo apt install python3-venv", PYTHON_ORG),
    ],
)
def test_where_nothing_is_found_one_line_says_what_to_install(
    machine, kernel, release, packages, without_uv, with_uv
):
    names = " ".join(f"python{version} python{version}-venv" for version in packages.split())
    for name, answer in (("uname", kernel), ("cat", f"ID={release}"), ("apt-cache", names)):
        (machine.bin / name).unlink(missing_ok=True)
        machine.add(machine.bin / name, f"#!/bin/sh\nprintf '%s\\n' {answer}\n")
    machine.add_python(machine.bin / "python3", suits=False, venv=False)
    done = machine.run()
    reason = "found no uv, and no Python with venv that could fetch it"
    assert (done.returncode, done.stderr) == (1, f"error: {reason}: {without_uv}\n")
    machine.add_uv()
    done = machine.run()
    notice, error = done.stderr.splitlines()
    reason = "found no Python 3.12, 3.13 or 3.14, and uv could fetch none"
    assert (done.returncode, done.stdout) == (1, "")
    assert notice == "found no Python 3.12, 3.13 or 3.14: uv fetches one"
    assert error == f"error: {reason}: {with_uv}"
