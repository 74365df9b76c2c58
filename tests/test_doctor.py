import importlib.metadata
import os
import sys

from quadwalk.cli import doctor
from tests.programs import python


def run(**environment):
    return python("-m", "quadwalk", "doctor", env={**os.environ, **environment})


def test_what_there_is_is_named(tmp_path):
    (tmp_path / "file").touch()
    cores = len(os.sched_getaffinity(0))
    done = run(MUJOCO_GL="disable", XLA_FLAGS="", XDG_CACHE_HOME=str(tmp_path / "file"))
    assert done.returncode == 0
    assert f"jax {importlib.metadata.version('jax')}" in done.stdout
    assert f"{cores} cores" in done.stdout
    assert f"cpu:{cores - 1}\n" in done.stdout
    assert "by ray casting" in done.stdout
    assert f"\nwarning: cannot keep compiled programs in {tmp_path}" in done.stdout


def test_what_keeps_it_from_running_is_named(tmp_path):
    done = run(XLA_FLAGS="--xla_no_such=1")
    assert done.returncode == 1
    assert done.stderr == (
        "error: JAX and MuJoCo do not start: Unknown flag in XLA_FLAGS: --xla_no_such=1\n"
    )
    (tmp_path / "mujoco.py").write_text("raise ImportError('core bindings missing')")
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    assert "ImportError: core bindings missing\n" in run(PYTHONPATH=paths).stderr


def test_versions_that_are_not_those_demanded_are_named(monkeypatch, capsys):
    demands = ["jax==0.1", "nonesuch>=2", "numpy>=1", "absent ; extra == 'view'"]
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: demands)
    monkeypatch.setattr(doctor, "PROBE", "print('[[], null]')")
    doctor.main([])
    assert capsys.readouterr().out.splitlines()[-2:] == [
        f"warning: jax is {importlib.metadata.version('jax')}; expected jax==0.1",
        "warning: nonesuch is missing; expected nonesuch>=2",
    ]
