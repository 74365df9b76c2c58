"""The devices that are trained on, and what follows from them."""

import dataclasses
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest

from quadwalk.errors import UsageError
from quadwalk.learn import devices
from quadwalk.settings.training import DistributedConfig
from quadwalk.tasks import sprint


@pytest.fixture
def set_machine(monkeypatch):
    """Return a function that makes JAX see other devices than there are.

    That one returns a list of the numbers of CPU devices that JAX is asked for.
    """
    import jax

    def set_devices(platform: str, count: int, processes: int = 1, cores: int = 4):
        machine_devices = [
            SimpleNamespace(id=k, process=k * processes // count) for k in range(count)
        ]
        prepared: list[int] = []
        monkeypatch.setattr(devices, "_configure_jax", prepared.append)
        monkeypatch.setattr(devices, "join", lambda config: None)
        monkeypatch.setattr(devices, "count_cores", lambda: cores)
        monkeypatch.setattr(jax, "devices", lambda: machine_devices)
        monkeypatch.setattr(
            jax,
            "local_devices",
            lambda process: [d for d in machine_devices if d.process == process],
        )
        monkeypatch.setattr(jax, "default_backend", lambda: platform)
        return prepared

    return set_devices


@pytest.mark.parametrize(
    ("platform", "count", "cores", "envs_flag", "used"),
    [
        *[("cpu", n, n, None, used) for n, used in ((4, 4), (12, 8))],  # one for each core
        ("cpu", 3, 3, 96, 2),
        *[("cpu", n, 8, None, used) for n, used in ((1, 1), (2, 2), (3, 2), (6, 4))],  # no more
        *[("gpu", n, 64, None, used) for n, used in ((1, 1), (2, 2), (3, 2), (8, 8))],
    ],
)
def test_all_devices_are_used_that_can_share_evenly(
    set_machine, platform, count, cores, envs_flag, used
):
    prepared = set_machine(platform, count, cores=cores)
    config, chosen_devices = devices.choose_devices(
        dataclasses.replace(sprint.TASK, envs=envs_flag)
    )
    envs = envs_flag or {"cpu": 2048, "gpu": 8192}[platform]
    assert (config.envs, config.devices, len(chosen_devices)) == (envs, used, used)
    assert prepared == [used] or count != cores


def test_devices_stay_what_they_are_once_jax_has_computed():
    import jax

    before = len(jax.devices())
    assert before == 2  # as the tests are set up
    assert devices.set_up_devices(1) == before
    with pytest.raises(UsageError, match=f"--devices is {before + 1}; expected at most"):
        devices.set_up_devices(before + 1)


PAIR = DistributedConfig(coordinator="a:1", processes=2)


@pytest.mark.parametrize(
    ("distributed", "devices_flag", "used"),
    [(DistributedConfig(), 2, [0, 1]), (PAIR, 4, [0, 1, 4, 5])],
)
def test_what_is_asked_for_is_used_and_as_much_of_each_process(
    set_machine, distributed, devices_flag, used
):
    set_machine("gpu", 8, processes=distributed.processes)
    config, chosen_devices = devices.choose_devices(
        dataclasses.replace(sprint.TASK, envs=512, devices=devices_flag, distributed=distributed)
    )
    assert (config.envs, config.devices, [d.id for d in chosen_devices]) == (
        512,
        devices_flag,
        used,
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"devices": 16}, "--devices is 16; expected at most the 8 there are"),
        ({"devices": 3}, "--ppo.eval-envs is 64; expected a multiple of 3, the devices"),
        ({"envs": 100, "devices": 8}, "--envs is 100; expected a multiple of 32"),
        ({"envs": 7}, "--envs is 7; expected a multiple of 4 (1 devices"),
        ({"devices": 3, "distributed": PAIR}, "--devices is 3; expected a multiple of 2"),
    ],
)
def test_what_cannot_be_shared_is_named(set_machine, change, message):
    set_machine("gpu", 8)
    with pytest.raises(UsageError, match=re.escape(message)):
        devices.choose_devices(dataclasses.replace(sprint.TASK, **change))


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the folder has another variable")
def test_a_cache_that_cannot_be_kept_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    code = """
from quadwalk.learn.devices import set_up_devices
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
