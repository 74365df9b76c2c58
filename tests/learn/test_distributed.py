"""Several processes that share a training, on this machine."""

import os
import shutil
import signal
import socket
import time

import pytest

from quadwalk.paths import ALIENGO_URDF
from quadwalk.runs.directory import Run
from quadwalk.runs.log import read_metrics
from tests.test_task_files import OWN_TASK

ITERATIONS = 100


@pytest.fixture
def start_pair(start, tmp_path):
    """Start two processes with the same flags, where {} is the number of each.

    Return them and the files that they print to.
    """

    def start_both(*flags: str):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        shared = f"--distributed.coordinator=127.0.0.1:{port}", "--distributed.processes=2"
        arguments = *flags, *shared, "--distributed.process={}"
        outputs = [tmp_path / f"output{number}" for number in (0, 1)]
        return [
            start(output, *(flag.format(number) for flag in arguments))
            for number, output in enumerate(outputs)
        ], outputs

    return start_both


def wait_for_end(processes, outputs) -> list[str]:
    """Wait for the processes to end without an error; return what they printed."""
    for process, output in zip(processes, outputs, strict=True):
        process.join(200)
        assert process.exitcode == 0, output.read_text()
    return [output.read_text() for output in outputs]


def test_two_processes_learn_what_one_with_two_devices_does(
    start_pair, tmp_path, flags, same_result, train
):
    # Bit for bit: a mean over two devices is one addition, which does not care for the order.
    train(*flags(tmp_path, "alone", ITERATIONS))
    processes, outputs = start_pair(*flags(tmp_path, "shared", ITERATIONS))
    run = Run(tmp_path / "shared")
    while not (run.metrics.exists() and run.metrics.stat().st_size):
        assert processes[0].is_alive(), outputs[0].read_text()
        time.sleep(0.01)
    os.kill(processes[1].pid, signal.SIGINT)  # and both stop, after the same iteration
    first, second = wait_for_end(processes, outputs)
    steps = read_metrics(run)[-1]["steps"]
    assert steps < 64 * ITERATIONS
    assert f"stopped after {steps:,} of" in first
    assert "stopped" not in second
    assert run.locate_checkpoint(steps).exists()
    first, _ = wait_for_end(*start_pair(f"--runs={tmp_path}", "--resume=shared"))
    assert f"after {steps:,} steps" in first
    same_result(run.path, tmp_path / "alone", best=False)  # its checkpoints were others


def test_processes_that_differ_or_cannot_begin_all_say_so(start_pair, tmp_path, flags):
    """Check also that a robot's file in another place makes no difference."""
    for number in (0, 1):
        shutil.copy(ALIENGO_URDF, tmp_path / f"robot{number}.urdf")
        (tmp_path / f"task{number}.py").write_text(
            OWN_TASK.replace("return 1.0", f"return {number}.0")
        )
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").write_text("")
    differ = ("different settings", "different settings")
    for name, flag, expected in (
        ("a", "--seed={}", differ),
        ("b", f"{tmp_path}/task{{}}.py", differ),
        (
            "taken",
            f"--robot.urdf={tmp_path}/robot{{}}.urdf",
            ("run 'taken' exists", "another process could not begin"),
        ),
    ):
        processes, outputs = start_pair(flag, *flags(tmp_path, name, 5))
        for process, output, part in zip(processes, outputs, expected, strict=True):
            process.join(100)
            errors = [line for line in output.read_text().splitlines() if "error" in line]
            assert len(errors) == 1, output.read_text()
            assert part in errors[0]
            assert process.exitcode in (1, 2)
