"""Many trainings on a Ray cluster: none is lost with a machine, and addresses that are none."""

import os
import socket
import threading

import pytest
from judges import last_reward

from quadwalk.errors import UserError
from quadwalk.experiments.options import PlaceConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import run_jobs
from quadwalk.runs.directory import list_checkpoints

pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")  # Ray starts its processes
SEEDS = (0, 1, 2)
ITERATIONS = 30  # all checkpoints of which are kept


@pytest.fixture
def nodes(monkeypatch):
    """A Ray cluster of two machines with a core each, both of them this one; the second's node."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    here = os.path.dirname(__file__)
    monkeypatch.setenv("PYTHONPATH", here, prepend=os.pathsep)  # for the judges
    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    yield cluster, cluster.add_node(num_cpus=1)
    ray.shutdown()
    cluster.shutdown()


def test_no_training_is_lost_with_a_machine_and_results_are_those_of_processes(
    nodes, job, task, same_result
):
    cluster, second = nodes
    there = [job("cluster", f"s{seed}", ITERATIONS, last_reward, seed) for seed in SEEDS]
    killed = threading.Event()
    written = {}

    def watch(job, row):
        middle = [job for job in there if list_checkpoints(job.run)]
        if len(middle) > 1 and not killed.is_set():  # all that have a core, and wait
            assert len(middle) == 2
            for each in middle:
                path = list_checkpoints(each.run)[-1]
                written[path] = path.stat().st_mtime_ns
            cluster.remove_node(second, allow_graceful=False)
            task[1].touch()
            killed.set()
        return False

    place = make_place(PlaceConfig(cores=1, cluster=cluster.address))
    assert place.slots == 2
    found = {end.job.name: end.value for end in run_jobs(there, place, len(there), watch)}
    assert killed.is_set()
    # What was lost goes on from its last checkpoint, which is not computed again.
    assert {path: path.stat().st_mtime_ns for path in written} == written

    here = [job("here", f"s{seed}", ITERATIONS, last_reward, seed) for seed in SEEDS]
    local = run_jobs(here, make_place(PlaceConfig(cores=1)), len(here))
    assert {end.job.name: end.value for end in local} == found
    for one, other in zip(there, here, strict=True):
        same_result(one.run.path, other.run.path)


def test_an_interrupt_leaves_all_to_be_gone_on_with(nodes, assert_resumable):
    cluster, _ = nodes
    assert_resumable(PlaceConfig(cores=1, cluster=cluster.address))


def test_a_place_that_is_none_is_said_in_one_line():
    pytest.importorskip("ray")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    for address, said in (
        ("here", "--cluster is 'here'; expected HOST:PORT, auto or local"),
        (f"127.0.0.1:{port}", f"no Ray cluster answers at 127.0.0.1:{port}: .*refused"),
        ("no-such-host.invalid:6379", "no Ray cluster answers at no-such-host.invalid:6379"),
        ("auto", "cannot use the Ray cluster at auto: Could not find any running Ray instance"),
    ):
        with pytest.raises(UserError, match=said):
            make_place(PlaceConfig(cluster=address))
