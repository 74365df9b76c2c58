"""Which devices are trained on, and what follows from them."""

import dataclasses
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest

from quadwalk.errors import UsageError
from quadwalk.settings.training import DistributedConfig
from quadwalk.tasks import sprint
from quadwalk.train import devices


@pytest.fixture
def machine(monkeypatch):
    """Make JAX see other devices than there are."""
    import jax

    def be(platform: str, count: int, processes: int = 1, cores: int = 4):
        found = [SimpleNamespace(id=k, process=k * processes // count) for k in range(count)]
        monkeypatch.setattr(devices, "_prepare", lambda count: None)
        monkeypatch.setattr(devices, "join", lambda config: None)
        monkeypatch.setattr(devices, "cpu_cores", lambda: cores)
        monkeypatch.setattr(jax, "devices", lambda: found)
        monkeypatch.setattr(
            jax, "local_devices", lambda process: [d for d in found if d.process == process]
        )
        monkeypatch.setattr(jax, "default_backend", lambda: platform)

    return be


@pytest.mark.parametrize(
    ("platform", "count", "cores", "envs", "used"),
    [
        ("cpu", 4, 4, 2048, 4),  # one for each core
        *[("cpu", count, 8, 2048, used) for count, used in ((1, 1), (3, 2), (6, 4))],  # no more
        *[("gpu", n, 64, 8192, used) for n, used in ((1, 1), (2, 2), (3, 2), (8, 8))],
    ],
)
def test_all_devices_are_used_that_can_share_evenly(machine, platform, count, cores, envs, used):
    machine(platform, count, cores=cores)
    config, found = devices.choose_devices(sprint.TASK)
    assert (config.envs, config.devices, len(found)) == (envs, used, used)


def test_devices_stay_what_they_are_once_jax_has_computed():
    import jax

    before = len(jax.devices())
    assert before == 2  # as the tests are set up
    assert devices.set_up_devices(1) == before
    with pytest.raises(UsageError, match=f"--devices is {before + 1}; expected at most"):
        devices.set_up_devices(before + 1)


def test_what_is_asked_for_is_what_is_used(machine):
    machine("gpu", 8)
    config, found = devices.choose_devices(dataclasses.replace(sprint.TASK, envs=512, devices=2))
    assert (config.envs, config.devices, [d.id for d in found]) == (512, 2, [0, 1])


def test_each_process_brings_as_many_devices(machine):
    machine("gpu", 8, processes=2)
    pair = DistributedConfig(coordinator="a:1", processes=2)
    config, found = devices.choose_devices(
        dataclasses.replace(sprint.TASK, devices=4, distributed=pair)
    )
    assert config.devices == 4
    assert [(d.process, d.id) for d in found] == [(0, 0), (0, 1), (1, 4), (1, 5)]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"devices": 16}, "--devices is 16; expected at most the 8 there are"),
        ({"devices": 3}, "--ppo.eval-envs is 64; expected a multiple of 3, the devices"),
        ({"envs": 100, "devices": 8}, "--envs is 100; expected a multiple of 32"),
    ],
)
def test_what_cannot_be_shared_is_named(machine, change, named):
    machine("gpu", 8)
    with pytest.raises(UsageError, match=re.escape(named)):
        devices.choose_devices(dataclasses.replace(sprint.TASK, **change))


def test_devices_that_the_processes_cannot_share_are_named(machine):
    machine("cpu", 4, processes=2)
    pair = DistributedConfig(coordinator="a:1", processes=2)
    with pytest.raises(UsageError, match="--devices is 3; expected a multiple of 2"):
        devices.choose_devices(dataclasses.replace(sprint.TASK, devices=3, distributed=pair))


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the folder has another variable")
def test_a_cache_that_cannot_be_kept_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    code = """
from quadwalk.train.devices import set_up_devices
set_up_devices(1), set_up_devices(1)
import jax
jax.jit(lambda x: 2 * x)(1.0).block_until_ready()
"""
    environment = {
        **os.environ,
        "XDG_CACHE_HOME": str(tmp_path / "file"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0
    assert done.stderr.startswith(f"warning: cannot keep compiled programs in {tmp_path}/file/")
    assert done.stderr.endswith(": Not a directory; every start compiles anew\n")
    assert done.stderr.count("\n") == 1
