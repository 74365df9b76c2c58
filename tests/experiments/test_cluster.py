"""Many trainings on a Ray cluster: none is lost with a machine, and addresses that are none."""

import os
import socket
import threading

import pytest
from measures import get_last_reward

from quadwalk.errors import UserError
from quadwalk.experiments.options import PlaceConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import run_jobs
from quadwalk.runs.directory import list_checkpoints

pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")  # Ray starts its processes
ITERATIONS = 30  # all checkpoints of which are kept


def test_a_place_that_is_none_is_said_in_one_line():  # while there is no cluster here
    pytest.importorskip("ray")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    for address, message in (
        ("here", "--cluster is 'here'; expected HOST:PORT, auto or local"),
        (f"127.0.0.1:{port}", f"no Ray cluster answers at 127.0.0.1:{port}: .*refused"),
        ("no-such-host.invalid:6379", "no Ray cluster answers at no-such-host.invalid:6379"),
        ("auto", "cannot use the Ray cluster at auto: Could not find any running Ray instance"),
    ):
        with pytest.raises(UserError, match=message):
            make_place(PlaceConfig(cluster=address))


@pytest.fixture(scope="module")
def cluster():
    """Yield a Ray cluster of this machine alone, with one core."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        # For the evaluations.
        patch.setenv("PYTHONPATH", os.path.dirname(__file__), prepend=os.pathsep)
        patch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        cluster = Cluster(
            initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
        )
        yield cluster
        ray.shutdown()
        cluster.shutdown()


def test_no_training_is_lost_with_a_machine_and_results_are_those_of_one_alone(
    cluster, job, task, same_result, train_alone
):
    second = cluster.add_node(num_cpus=1)
    jobs = [job("cluster", f"s{seed}", ITERATIONS, get_last_reward, seed) for seed in (0, 1)]
    killed = threading.Event()
    times = {}

    def watch(job, row):
        paths = [list_checkpoints(job.run)[-1] for job in jobs if list_checkpoints(job.run)]
        if len(paths) == 2 and not killed.is_set():  # both wait
            times.update({path: path.stat().st_mtime_ns for path in paths})
            cluster.remove_node(second, allow_graceful=False)
            task[1].touch()
            killed.set()
        return False

    place = make_place(PlaceConfig(cores=1, cluster=cluster.address))
    assert place.slots == 2
    outcomes = list(run_jobs(jobs, place, len(jobs), watch))
    assert killed.is_set()
    assert [outcome.error for outcome in outcomes] == [None, None]
    # What was lost goes on from its last checkpoint, which is not computed again.
    assert {path: path.stat().st_mtime_ns for path in times} == times
    for seed, one in enumerate(jobs):
        same_result(one.run.path, train_alone(ITERATIONS, seed).path)


def test_an_interrupt_leaves_all_to_be_resumed(cluster, assert_resumable):
    assert_resumable(PlaceConfig(cores=1, cluster=cluster.address))
