"""Exported policies: files that agree with JAX, and a script that drives as our engine does."""

import ast
import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import onnx
import onnxruntime
import pytest
import yaml
from brax.training.networks import ACTIVATION
from rich.console import Console

from benchmarks.shared import find_example_robots
from quadwalk.cli.shell import suggest_install
from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UserError
from quadwalk.evaluation.load import LoadedRun, load_run
from quadwalk.evaluation.rollout import Rollout, simulate_episodes
from quadwalk.export.bundle import SCRIPTS, export_run, load_flat
from quadwalk.export.check import check_export, read_recording, replay
from quadwalk.export.cli import main
from quadwalk.export.controller import Controller, read_list
from quadwalk.export.description import describe
from quadwalk.export.policy_graph import (
    ACTIVATIONS,
    JointTargets,
    Weights,
    build_model,
    find_joint_targets,
    list_inputs,
)
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run
from quadwalk.settings.environment import BodiesConfig
from quadwalk.settings.registry import TERMS
from quadwalk.settings.terms import ActionMap
from quadwalk.settings.training import OtherRobotConfig
from quadwalk.task_files import load_task
from quadwalk.tasks import universal
from tests.settings.test_registry import to_module_names
from tests.untrained import write_run

SECONDS = 0.5


class Exported(NamedTuple):
    """An exported policy, and one of its episodes as our MuJoCo C engine steps it."""

    folder: Path
    loaded: LoadedRun
    rollout: Rollout

    @property
    def task(self) -> str:
        return self.loaded.policy.config.task

    @property
    def metadata(self) -> dict[str, str]:
        return read_metadata(self.folder)

    def check(self, folder: Path, recording: Path | None = None) -> None:
        check_export(self.loaded, folder, recording, Console(quiet=True))

    def copy(self, folder: Path, edit: Callable[[onnx.ModelProto], None]) -> Path:
        """Copy the export, with an edited policy.onnx."""
        shutil.copytree(self.folder, folder)
        model = onnx.load(folder / "policy.onnx")
        edit(model)
        onnx.save(model, folder / "policy.onnx")
        return folder


def read_metadata(folder: Path) -> dict[str, str]:
    model = onnx.load(folder / "policy.onnx")
    return {entry.key: entry.value for entry in model.metadata_props}


def make_untrained_run(root: Path, task: str, quadruped) -> Run:
    """Return a run as a training would leave it, with a policy that has learned nothing."""
    return write_run(root, task, quadruped, {"policy.npz": 0}, load_task(task), never_varied=[3])


@pytest.fixture(scope="module", params=["run", "walk"])
def exported(request, quadruped, tmp_path_factory) -> Exported:
    root = tmp_path_factory.mktemp("export")
    run = make_untrained_run(root, request.param, quadruped)
    main([str(run.path), "-o", str(root / "out")])
    loaded = load_run(run, SECONDS, "last", "mujoco")
    config = loaded.env.config
    ranges = {f.name for f in dataclasses.fields(config.reset)} - {"pose", "height"}
    reset = dataclasses.replace(config.reset, **dict.fromkeys(ranges, 0.0))
    env = QuadrupedEnv(quadruped, dataclasses.replace(config, reset=reset), "mujoco")
    (rollout,) = simulate_episodes(env, loaded.policy.act, 1, seed=0)
    assert rollout.steps > 10
    return Exported(root / "out", loaded, rollout)


def test_onnx_and_jax_agree_on_an_episode(exported):
    env, rollout = exported.loaded.env, exported.rollout
    session = onnxruntime.InferenceSession(exported.folder / "policy.onnx")
    place = [rollout.observation_names.index(label) for label in list_inputs(env)]
    assert sorted(place) == list(range(env.policy_size))
    for k in range(rollout.steps):
        obs = rollout.observation[k, place][None]
        actions, targets = session.run(["actions", "joint_targets"], {"obs": obs})
        np.testing.assert_allclose(actions[0], rollout.action[k], atol=1e-5)
        np.testing.assert_allclose(targets[0], rollout.target[k], atol=1e-5)


def test_the_script_alone_drives_the_robot_as_our_engine_does(exported, tmp_path):
    """Run the script from another folder, in an environment without this package's path."""
    env, rollout = exported.loaded.env, exported.rollout
    folder = tmp_path / "elsewhere"
    shutil.copytree(exported.folder, folder)
    command = [sys.executable, folder / "run_policy.py", f"--seconds={SECONDS}", "--save=out.npz"]
    if rollout.command is not None:
        command += ["--command", *map(str, rollout.command[0])]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=60
    )
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "out.npz") as saved:
        time, qpos, target = saved["time"], saved["qpos"], saved["target"]
    steps = min(rollout.steps, len(time))
    np.testing.assert_allclose(time[:steps], rollout.time[:steps], atol=1e-9)
    # Robots part in the end, for robot.xml has six digits and contacts amplify what is left.
    early = min(steps, round(0.2 / env.config.control_dt))
    np.testing.assert_allclose(qpos[:early], rollout.qpos[:early], atol=1e-3)
    np.testing.assert_allclose(target[:early], rollout.target[:early], atol=1e-2)
    summary = re.search(r"(-?[\d.]+) m/s along x for ([\d.]+) s", done.stdout)
    assert summary is not None
    if len(time) == rollout.steps:
        speed = (rollout.qpos[-1, 0] - rollout.qpos[0, 0]) / rollout.time[-1]
        assert float(summary[1]) == pytest.approx(speed, abs=0.02)


def test_an_export_with_a_getup_policy_gets_up_from_its_back_and_goes_on(tmp_path, capsys):
    main(["drive", f"--runs={tmp_path}", f"--out={tmp_path / 'both'}", "--getup=getup"])
    nodes = onnx.load(tmp_path / "both" / "getup.onnx").graph.node
    assert "Sin" in {node.op_type for node in nodes}  # its noise
    command = [sys.executable, tmp_path / "both" / "run_policy.py", "--fallen", "--seconds=5"]
    command += [f"--save={tmp_path / 'out.npz'}", "--command", "1", "0", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert "got up once" in done.stdout
    with np.load(tmp_path / "out.npz") as saved:
        qpos, time = saved["qpos"], saved["time"]
    np.testing.assert_array_equal(qpos[0, 3:7], [0.0, 1.0, 0.0, 0.0])
    last = time > time[-1] - 1.0
    assert np.ptp(qpos[last, 0]) == pytest.approx(1.0, abs=0.3)  # m in a second, as told
    assert np.all(qpos[last, 2] > 0.2)
    # Upright with its legs folded, on its belly, it gets up as well.
    script = tmp_path / "both" / "run_policy.py"
    text, back = script.read_text(), "data.qpos[3:7] = 0, 1, 0, 0"
    assert text.count(back) == 1
    script.write_text(
        text.replace(back, "data.qpos[2], data.qpos[7:] = 0.09, np.tile([0, 1.5, -2.6], 4)")
    )
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert "got up once" in done.stdout, done.stderr


def test_the_scripts_are_short_and_need_three_packages():
    needed = {"run_policy.py": {"numpy", "mujoco", "controller"}}
    needed["controller.py"] = {"numpy", "onnxruntime"}
    assert sum(script.read_text().count("\n") for script in SCRIPTS) <= 350
    for script in SCRIPTS:
        source = script.read_text()
        roots = set()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                roots |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                roots.add(str(node.module).partition(".")[0])
        assert roots - set(sys.stdlib_module_names) == needed.pop(script.name)
    assert not needed


def halve_last(text: str) -> str:
    """Return a list of numbers with the last of them halved."""
    *others, last = json.loads(text)
    return json.dumps([*others, last / 2])


# What is broken, of which task: an entry of the metadata, or a constant of the graph.
BROKEN = {
    "run": [("joint_stiffness", "physics, "), ("w_0", "action, ")],
    "walk": [("default_joint_pos", "observation, joint_pos_RL_calf_joint"), ("scale", "target, ")],
}


def test_the_check_agrees_and_names_what_is_broken(exported, tmp_path, capsys):
    main([str(exported.loaded.run.path), "--check", "-o", str(exported.folder)])
    assert capsys.readouterr().out == "no difference\n"
    for name, stage in BROKEN[exported.task]:

        def break_one(model: onnx.ModelProto, name: str = name) -> None:
            for entry in model.metadata_props:
                if entry.key == name:
                    entry.value = halve_last(entry.value)
            for constant in model.graph.initializer:
                if constant.name == name:
                    values = onnx.numpy_helper.to_array(constant)
                    constant.CopyFrom(onnx.numpy_helper.from_array(values / np.float32(2), name))

        folder = exported.copy(tmp_path / name, break_one)
        with pytest.raises(UserError, match=rf"difference is in step \d+, {stage}") as error:
            exported.check(folder)
        assert (f"its {name} is " in str(error.value)) == (name in exported.metadata)


@pytest.mark.parametrize("exported", ["walk"], indirect=True)
def test_the_check_reads_the_recording_of_another_runtime(exported, tmp_path):
    columns = replay(exported.folder, exported.loaded)
    recording = tmp_path / "own.npz"

    def check(**changes: np.ndarray) -> None:
        np.savez(recording, **{**columns, **changes})
        exported.check(exported.folder, recording)

    check()
    obs = columns["obs"].copy()
    obs[5, 0] += 0.1
    with pytest.raises(UserError, match="in step 5, observation, "):
        check(obs=obs)
    with pytest.raises(UserError, match=r"obs has the shape .*; expected \(steps, "):
        check(obs=obs[:, 1:])
    recording.write_text("no NPZ")
    with pytest.raises(UserError, match="cannot be read; expected NPZ"):
        read_recording(recording, exported.loaded)


def test_the_metadata_says_what_mjlab_says(exported):
    env, about = exported.loaded.env, exported.metadata

    def numbers(key: str) -> np.ndarray:
        return np.array(json.loads(about[key]), float)

    assert json.loads(about["joint_names"]) == list(env.quadruped.joints)
    assert json.loads(about["observation_names"]) == list(env.config.observation)
    functions = set(json.loads(about["observation_functions"]))
    assert functions <= {name for name in TERMS if name.startswith("observation:")}
    assert about["command_names"] == ("velocity" if env.config.command.active else "")
    np.testing.assert_allclose(numbers("default_joint_pos"), env.robot.home[7:], rtol=1e-6)
    np.testing.assert_allclose(numbers("joint_stiffness"), env.motor.kp, rtol=1e-6)
    np.testing.assert_allclose(numbers("joint_damping"), env.motor.kd, rtol=1e-6)
    sizes, history = numbers("observation_sizes"), numbers("observation_history")
    assert sizes @ (1 + history) == env.policy_size
    assert float(about["control_period"]) == pytest.approx(env.config.control_dt)
    model = onnx.load(exported.folder / "policy.onnx")
    assert [(o.domain, o.version) for o in model.opset_import] == [("", 17)]
    assert model.graph.output[0].name == "actions"  # the one that unitree_rl_lab's runtime reads


def test_a_joint_with_a_comma_in_its_name_is_one_of_twelve(exported, monkeypatch):
    env = exported.loaded.env
    joints = ("FR,hip joint", 'a "b"', "[c", *env.quadruped.joints[3:])
    monkeypatch.setattr(env, "quadruped", dataclasses.replace(env.quadruped, joints=joints))
    about = describe(exported.loaded, find_joint_targets(env.config.action, env.robot))
    assert tuple(json.loads(about["joint_names"])) == joints
    assert tuple(read_list(about["joint_names"])) == joints


def test_a_number_without_limit_is_null_in_json():
    assert read_list("[1, null]") == read_list("[1, null]".replace("null", "1e999")) == [1, np.inf]
    assert read_list("1,inf") == ["1", "inf"]


def name_by_module(model: onnx.ModelProto) -> None:
    (entry,) = (e for e in model.metadata_props if e.key == "observation_functions")
    count = len(json.loads(entry.value))
    entry.value = to_module_names(entry.value)
    assert entry.value.count("quadwalk.task.observation:") == count


def separate_by_commas(model: onnx.ModelProto) -> None:
    lists = [entry for entry in model.metadata_props if entry.value.startswith("[")]
    assert len(lists) > 10
    for entry in lists:
        entry.value = ",".join(str(part) for part in read_list(entry.value))


@pytest.mark.parametrize("edit", [name_by_module, separate_by_commas])
@pytest.mark.parametrize("exported", ["walk"], indirect=True)
def test_an_export_of_an_earlier_version_runs_and_is_checked(exported, tmp_path, edit):
    exported.check(exported.copy(tmp_path / "old", edit))


@pytest.mark.parametrize("exported", ["walk"], indirect=True)
def test_an_entry_of_the_metadata_that_differs_is_named(exported, tmp_path):
    def change(model: onnx.ModelProto) -> None:
        separate_by_commas(model)
        (entry,) = (e for e in model.metadata_props if e.key == "joint_armature")
        entry.value = "none"

    with pytest.raises(UserError, match="its joint_armature is none at number 0; expected "):
        exported.check(exported.copy(tmp_path / "changed", change))


def test_a_packaged_policy_is_exported_with_registered_names(tmp_path):
    main([str(PRETRAINED / "walk"), "-o", str(tmp_path)])
    functions = json.loads(read_metadata(tmp_path)["observation_functions"])
    assert {"observation:joint_pos", "observation:trot_clock"} <= set(functions)
    assert "joint_pos_rel" in (tmp_path / "deploy.yaml").read_text()


def test_deploy_yaml_gives_the_observations_and_targets_that_were_trained_with(exported):
    """Read the file with another reader, and join its parts as unitree_rl_lab's runtime does."""
    env, rollout = exported.loaded.env, exported.rollout
    config = yaml.safe_load((exported.folder / "deploy.yaml").read_text())
    action = config["actions"]["JointPositionAction"]
    targets = rollout.action * action["scale"] + action["offset"]
    targets = np.clip(targets, *np.transpose(action["clip"]))
    np.testing.assert_allclose(targets, rollout.target, atol=1e-5)
    assert config["joint_ids_map"] == list(range(12))
    assert config["step_dt"] == env.config.control_dt
    terms = config["observations"]
    sizes = [len(term["scale"]) for term in terms.values()]
    lengths = [term["history_length"] for term in terms.values()]
    # It keeps each term's readings, the oldest first, and lines the terms up.
    k, labels = rollout.steps - 1, list_inputs(env)
    obs = dict(zip(rollout.observation_names, rollout.observation[k], strict=True))
    at = 0
    for name, size, length in zip(terms, sizes, lengths, strict=True):
        part = labels[at : at + size * length]
        at += size * length
        if name == "joint_vel_rel":
            history = rollout.qvel[k - length + 1 : k + 1, 6:].ravel()
            np.testing.assert_allclose([obs[label] for label in part], history, atol=1e-5)
    assert at == len(labels)
    if env.config.command.active:
        ranges = config["commands"]["base_velocity"]["ranges"]
        assert tuple(ranges["lin_vel_x"]) == env.config.command.forward


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_every_activation_is_that_of_brax(name):
    rng = np.random.default_rng(0)
    layers = [
        (np.float32(rng.normal(size=(m, n))), np.float32(rng.normal(size=n)))
        for m, n in ((5, 7), (7, 12))
    ]
    weights = Weights(np.zeros(5), np.ones(5), layers, name)
    targets = JointTargets(np.eye(12), *(np.full(12, x) for x in (0.0, -np.inf, np.inf)))
    model = build_model(weights, np.arange(5), targets, {})
    session = onnxruntime.InferenceSession(model.SerializeToString())
    x = np.float32(rng.normal(size=(1, 5)))
    hidden = ACTIVATION[name](jnp.asarray(x @ layers[0][0] + layers[0][1]))
    expected = jnp.tanh(hidden @ layers[1][0] + layers[1][1])
    actions, targets = session.run(None, {"obs": x})
    np.testing.assert_allclose(actions, expected, atol=1e-5)
    np.testing.assert_allclose(targets, actions)


def bend(robot, action, joints, *, bend, near):
    return robot.home_joints + 0.2 * action + bend * action**3 + near * joints


@pytest.mark.parametrize("params", [{"bend": 0.1, "near": 0.0}, {"bend": 0.0, "near": 0.1}])
def test_an_action_map_that_no_format_can_state_is_named(env, params):
    with pytest.raises(UserError, match=r"^the action map bend cannot be exported; expected"):
        find_joint_targets(ActionMap(bend, params), env.robot)
    straight = find_joint_targets(ActionMap(bend, dict.fromkeys(params, 0.0)), env.robot)
    np.testing.assert_allclose(straight.scale, 0.2, rtol=1e-6)


@pytest.mark.parametrize("missing", ["onnx", "onnxruntime"])
def test_without_the_extra_one_line_says_so(missing, quadruped, tmp_path, monkeypatch):
    run = make_untrained_run(tmp_path, "walk", quadruped)
    monkeypatch.setitem(sys.modules, missing, None)
    for name in [name for name in sys.modules if name.startswith("quadwalk.export.")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(UserError) as caught:
        main([str(run.path)])
    expected = f"{missing} is not installed; export needs: {suggest_install('export')}"
    assert str(caught.value) == expected
    assert not (run.path / "export").exists()


def find_onnxruntime() -> Path | None:
    """Return ONNX Runtime's library, if a C++ compiler and the headers are there as well."""
    (folder,) = onnxruntime.__path__
    libraries = sorted(Path(folder, "capi").glob("libonnxruntime.so.*"))
    if not libraries or shutil.which("g++") is None:
        return None
    command = ["g++", "-E", "-x", "c++", "-include", "onnxruntime_cxx_api.h", os.devnull]
    compiles = subprocess.run(command, capture_output=True, check=False).returncode == 0
    return libraries[0] if compiles else None


def test_the_loop_in_cpp_computes_the_targets_of_the_controller(exported, tmp_path):
    library = find_onnxruntime()
    if library is None:
        pytest.skip("needs g++ and ONNX Runtime's C++ headers, their folder in CPATH")
    (tmp_path / "libonnxruntime.so.1").symlink_to(library)
    program = tmp_path / "control_loop"
    source = Path(__file__).parents[2] / "docs/control_loop.cpp"
    command = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", source, library, "-o", program]
    subprocess.run([*command, f"-Wl,-rpath,{tmp_path}"], check=True)

    controller = Controller(exported.folder / "policy.onnx")
    rng = np.random.default_rng(0)
    lines, expected = [], []
    for step in range(30):
        quat = np.append(1.0, rng.normal(0.0, 0.0 if step == 0 else 0.2, 3))  # heading 0 at first
        q = np.concatenate([np.zeros(3), quat / np.linalg.norm(quat), rng.normal(0.0, 1.0, 12)])
        v = rng.normal(0.0, 2.0, 18)
        velocity = np.zeros(3) if 10 <= step < 20 else rng.uniform(-1.0, 1.0, 3)
        expected.append(controller.compute_targets(q, v, velocity))
        lines.append(" ".join(map(str, [*q[3:7], *v[3:6], *q[7:], *v[6:], *velocity])))
    lines.append(" ".join(map(str, [0.7, 0.7, 0.0, 0.0, *np.zeros(30)])))  # on its side
    done = subprocess.run(
        [program, exported.folder / "policy.onnx"],
        input="\n".join(lines), capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    targets = np.array([line.split() for line in done.stdout.splitlines()], float)
    np.testing.assert_allclose(targets, expected, atol=1e-5)
    assert "error: unsafe state" in done.stderr
    assert done.returncode == 1


def test_a_policy_of_many_bodies_is_exported_for_a_robot_with_knees_ahead(quadruped, tmp_path):
    """Check that run_policy.py observes, acts and simulates as the policy does here."""
    bodies = dataclasses.replace(universal.TASK.env, bodies=BodiesConfig())
    run = write_run(
        tmp_path,
        "many",
        quadruped,
        {"policy.npz": 1},
        dataclasses.replace(universal.TASK, env=bodies),
    )
    file = find_example_robots() / "anymal_c_simple_description/urdf/anymal.urdf"
    robot = OtherRobotConfig(urdf=file).find()
    out, console = tmp_path / "export", Console(quiet=True)
    files = export_run(run, "last", out, console, robot=robot)
    assert "deploy.yaml" not in {path.name for path in files}
    check_export(load_flat(run, "last", robot), out, None, console)
