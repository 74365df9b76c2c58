"""MCAP files: read back by other people's readers, and whole or absent whatever goes wrong."""

import dataclasses
import gzip
import json
import os
import pickle
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from quadwalk.cli.shell import find_program
from quadwalk.errors import UserError
from quadwalk.evaluation.mcap import write as writing
from quadwalk.evaluation.mcap.urdf import draw_urdf
from quadwalk.evaluation.mcap.write import (
    LAYOUT,
    RERUN_BLUEPRINT,
    format_rerun_commands,
    write_mcap,
)
from quadwalk.evaluation.rollout import Rollout, slice_steps
from quadwalk.identify.log import read_log
from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from tests.evaluation.conftest import read_messages, read_records
from tests.robot.robots import make_data, make_frame, shape

METADATA = {"version": "1.2.3", "config": '{"seed": 7}'}
SCENE_ROWS = [*range(0, 100, 3), 100]  # of 100 steps: each third state, and the last
CLOSE = {"rtol": 1e-6, "atol": 1e-12}


@pytest.fixture(scope="module")
def episode_file(tmp_path_factory, trot, quadruped) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "episode.mcap"
    write_mcap(path, trot, quadruped, METADATA, {"config.json": b"{}", "big.txt": b"x" * 50_000})
    return path


@pytest.fixture(scope="module")
def messages(episode_file) -> dict[str, list]:
    return read_messages(episode_file)


@pytest.fixture
def read_back(trot, quadruped, tmp_path):
    """Return read_back(**changes): the messages of a file of `trot`, or `rollout`, with changes."""

    def run(rollout=trot, **changes) -> dict[str, list]:
        path = tmp_path / "a.mcap"
        write_mcap(path, dataclasses.replace(rollout, **changes), quadruped, {})
        return read_messages(path)

    return run


# What the file says


def test_every_channel_and_its_times(messages, trot):
    grid = [k * 20_000_000 for k in range(trot.steps + 1)]
    times = {
        **dict.fromkeys(("/tf", "/joint_states", "/pose", "/base_velocity", "/imu"), grid),
        **dict.fromkeys(("/contacts", "/reward"), grid[1:]),  # what a step produced
        **dict.fromkeys(("/action", "/observation", "/joint_cmd"), grid[:-1]),  # began with
        "/robot_description": [0],
        "/scene": [grid[row] for row in SCENE_ROWS],
        "/log": [0, grid[-1]],
    }
    assert {topic: [when for when, _ in actual] for topic, actual in messages.items()} == times


def test_embedded_times_are_the_log_times(messages):
    for topic, actual in messages.items():
        if topic == "/robot_description":
            continue
        for when, message in actual:
            if topic == "/tf":
                stamps = [transform.timestamp for transform in message.transforms]
            elif topic == "/scene":
                stamps = [entity.timestamp for entity in message.entities]
            else:
                stamps = [message.timestamp]
            assert {stamp.ToNanoseconds() for stamp in stamps} == {when}


def test_the_robot_description_is_the_urdf_that_is_drawn(messages, quadruped):
    ((when, data),) = messages["/robot_description"]
    text = data[8:-1]
    assert when == 0
    assert data == b"\x00\x01\x00\x00" + (len(text) + 1).to_bytes(4, "little") + text + b"\x00"
    description, full = ElementTree.fromstring(text), ElementTree.fromstring(quadruped.urdf)
    assert full.findall("link/collision")
    assert not description.findall("link/collision")
    for kind in ("joint", "link/visual", "link/inertial", "material"):
        for actual, expected in zip(description.findall(kind), full.findall(kind), strict=True):
            assert ElementTree.tostring(actual).strip() == ElementTree.tostring(expected).strip()


def test_a_link_without_visuals_is_drawn_by_its_collision_shapes(quadruped):
    urdf = "<robot name='r'><link name='a'><collision/></link></robot>"
    assert "<collision/>" in draw_urdf(urdf, quadruped.make_full_model())


@pytest.fixture(scope="module")
def meshed(tmp_path_factory) -> Quadruped:
    """Return the robot with meshes: as the visual of its trunk, and for all of a hip."""
    folder = tmp_path_factory.mktemp("meshed")
    (folder / "meshes").mkdir()
    trimesh.creation.box((0.4, 0.2, 0.1)).export(folder / "meshes" / "trunk.stl")
    hip = trimesh.creation.box((0.1, 0.06, 0.08))
    hip.apply_translation((0.0, 0.02, -0.01)).export(folder / "meshes" / "hip.stl")
    root = ElementTree.fromstring(ALIENGO_URDF.read_text())
    for name, file, kinds in (
        ("trunk", "trunk.stl", ("visual",)),
        ("FR_hip", "hip.stl", ("visual", "collision")),
    ):
        (link,) = root.findall(f"link[@name='{name}']")
        for kind in kinds:
            for element in link.findall(kind):
                link.remove(element)
        mesh = shape(f'mesh filename="meshes/{file}"', kind="visual")
        link.append(ElementTree.fromstring(mesh))
    (folder / "dog.urdf").write_bytes(ElementTree.tostring(root))
    return load_quadruped(folder / "dog.urdf")


def test_a_mesh_is_drawn_as_a_shape_that_needs_no_file(meshed):
    text = draw_urdf(meshed.urdf, meshed.make_full_model())
    assert "mesh" not in text
    description = ElementTree.fromstring(text)
    (trunk,) = description.findall("link[@name='trunk']/visual/geometry/box")
    assert trunk.get("size") == "0.647 0.15 0.112"  # as it collides
    (hip,) = description.findall("link[@name='FR_hip']/visual")  # its mesh's bounds
    origin = {name: np.array(x.split(), float) for name, x in hip.find("origin").attrib.items()}
    np.testing.assert_allclose(origin["xyz"], [0.0, 0.02, -0.01], atol=1e-6)
    size = np.array(hip.find("geometry/box").get("size").split(), float)
    reach = np.abs(Rotation.from_euler("xyz", origin["rpy"]).as_matrix()) @ size
    np.testing.assert_allclose(reach, [0.1, 0.06, 0.08], atol=1e-5)
    full = ElementTree.fromstring(meshed.urdf)
    calves = (x.findall("link[@name='FR_calf']/visual") for x in (description, full))
    assert len({tuple(map(ElementTree.tostring, shapes)) for shapes in calves}) == 1


def test_transforms_compose_to_the_simulators_poses(messages, trot, quadruped):
    model = quadruped.make_full_model()
    for row in (0, 1, 37, trot.steps):
        frames = {"world": np.eye(4)}
        for transform in messages["/tf"][row][1].transforms:
            turn, move = transform.rotation, transform.translation
            local = make_frame((move.x, move.y, move.z), (turn.w, turn.x, turn.y, turn.z))
            frames[transform.child_frame_id] = frames[transform.parent_frame_id] @ local
        data = make_data(model, trot.qpos[row])
        for name in (model.body(k).name for k in range(1, model.nbody)):
            np.testing.assert_allclose(frames[name][:3, 3], data.body(name).xpos, atol=1e-5)
            rotation = data.body(name).xmat.reshape(3, 3)
            np.testing.assert_allclose(frames[name][:3, :3], rotation, atol=1e-5)
        for name in (*quadruped.feet, "imu_link"):  # fixed links, which MuJoCo has as sites
            np.testing.assert_allclose(frames[name][:3, 3], data.site(name).xpos, atol=1e-5)


def test_every_link_of_the_urdf_has_its_transform_in_each_message(messages, quadruped):
    urdf = ElementTree.fromstring(quadruped.urdf)
    joints = urdf.findall("joint")
    expected = {("world", quadruped.trunk)}
    expected |= {(j.find("parent").get("link"), j.find("child").get("link")) for j in joints}
    assert len(expected) == len(urdf.findall("link"))
    for _, message in messages["/tf"]:
        actual = [(each.parent_frame_id, each.child_frame_id) for each in message.transforms]
        assert len(actual) == len(expected)
        assert set(actual) == expected
        # A reader that goes through them once finds each parent before its children.
        reached = {"world"}
        for parent, child in actual:
            assert parent in reached
            reached.add(child)


def test_joint_states_and_commands(messages, trot, quadruped):
    for row, (_, message) in enumerate(messages["/joint_states"]):
        joints = message.joints
        assert tuple(joint.name for joint in joints) == quadruped.joints
        np.testing.assert_allclose([j.position for j in joints], trot.qpos[row, 7:], **CLOSE)
        np.testing.assert_allclose([j.velocity for j in joints], trot.qvel[row, 6:], **CLOSE)
        assert [joint.HasField("effort") for joint in joints] == [row > 0] * 12
        if row:
            np.testing.assert_allclose([j.effort for j in joints], trot.torque[row - 1], **CLOSE)
    for row, (_, message) in enumerate(messages["/joint_cmd"]):
        assert tuple(joint.name for joint in message.joints) == quadruped.joints
        np.testing.assert_allclose([j.position for j in message.joints], trot.target[row], **CLOSE)


def test_typed_channels_name_each_quantity(messages, trot, quadruped):
    def read_column(topic: str, field: str) -> list:
        return [getattr(message, field) for _, message in messages[topic]]

    for k, joint in enumerate(quadruped.joints):
        np.testing.assert_allclose(read_column("/action", joint), trot.action[:, k], **CLOSE)
    for k, leg in enumerate(quadruped.legs):
        assert read_column("/contacts", leg) == trot.contact[:, k].tolist()
        forces = read_column("/contacts", f"{leg}_force")
        np.testing.assert_allclose(forces, trot.foot_force[:, k], **CLOSE)
    for name, values in trot.reward_terms.items():
        np.testing.assert_allclose(read_column("/reward", name), values, **CLOSE)
    np.testing.assert_allclose(read_column("/reward", "total"), trot.reward, **CLOSE)
    for k in (0, 5, 46):
        observed = read_column("/observation", f"seen_{k}")
        np.testing.assert_allclose(observed, trot.observation[:, k], **CLOSE)
    np.testing.assert_allclose(read_column("/base_velocity", "world_x"), trot.qvel[:, 0], **CLOSE)
    np.testing.assert_allclose(read_column("/pose", "pose")[3].position.z, trot.qpos[3, 2], **CLOSE)


def test_the_accelerometer_feels_gravity_at_rest(simulate, read_back):
    last = read_back(simulate(60, sweep=0.0, lift=0.0))["/imu"][-1][1]
    assert last.accelerometer_z == pytest.approx(9.81, abs=0.3)
    assert abs(last.accelerometer_x) < 0.3
    assert abs(last.roll) < 0.05
    assert abs(last.pitch) < 0.05


def test_body_velocity_is_turned_into_the_bodys_frame(trot, read_back):
    qpos, qvel = trot.qpos.copy(), trot.qvel.copy()
    qpos[:, 3:7] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]  # facing left: world y is ahead
    qvel[:, :3] = [0, 2, 0]
    message = read_back(qpos=qpos, qvel=qvel)["/base_velocity"][5][1]
    assert (message.body_x, message.body_y) == pytest.approx((2.0, 0.0), abs=1e-6)
    assert (message.world_x, message.world_y) == pytest.approx((0.0, 2.0), abs=1e-6)


def test_the_scene_is_complete_in_each_message(messages, trot, quadruped):
    model = quadruped.make_full_model()
    for row, (_, message) in zip(SCENE_ROWS, messages["/scene"], strict=True):
        ground, path, velocity, forces = message.entities
        ids = [entity.id for entity in message.entities]
        assert ids == ["ground", "path", "velocity", "foot_forces"]
        assert {entity.frame_id for entity in message.entities} == {"world"}
        assert len(ground.lines[0].points) % 2 == 0
        last = path.lines[0].points[-1]
        assert (last.x, last.y) == pytest.approx(trot.qpos[row, :2], abs=1e-3)
        assert len(path.lines[0].points) <= 64
        (arrow,) = velocity.arrows
        turn = arrow.pose.orientation
        along = make_frame(0, (turn.w, turn.x, turn.y, turn.z))[:3, 0]  # an arrow points along x
        arrow_vector = arrow.shaft_length * along
        np.testing.assert_allclose(arrow_vector, 0.25 * trot.qvel[row, :3], atol=2e-3)
        touching = np.flatnonzero(trot.contact[row - 1]) if row else []
        tails = [[getattr(arrow.pose.position, a) for a in "xyz"] for arrow in forces.arrows]
        assert len(tails) == len(touching)
        if tails:
            data = make_data(model, trot.qpos[row])
            feet = [data.site(quadruped.feet[foot]).xpos for foot in touching]
            np.testing.assert_allclose(tails, feet, atol=1e-3)


def test_metadata_and_attachments(episode_file, quadruped):
    records, attached = read_records(episode_file)
    assert records["quadwalk"] == METADATA
    assert records["episode"]["seed"] == "0"
    assert records["episode"]["end"] == "time limit"
    assert float(records["episode"]["control_dt"]) == 0.02
    assert attached["config.json"].data == b"{}"
    assert attached["config.json"].media_type == "application/json"
    assert gzip.decompress(attached["aliengo.urdf.gz"].data).decode() == quadruped.urdf
    assert gzip.decompress(attached["big.txt.gz"].data) == b"x" * 50_000
    layout = json.loads(attached["foxglove_layout.json"].data)
    assert layout["configById"]["3D!robot"]["followTf"] == quadruped.trunk


def test_the_layout_shows_only_what_is_in_the_file(messages):
    layout = json.loads(LAYOUT.read_text())
    panels = layout["configById"]

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)
    for panel in panels.values():
        for path in panel.get("paths", ()):
            topic, *fields = path["value"].split(".")
            value = messages[topic][1][1]
            if topic == "/reward" and fields != ["total"]:
                continue  # the terms are the environment's to choose
            for field in fields:
                name, _, index = field.partition("[")
                value = getattr(value, name)
                if index:
                    value = value[int(index[:-1])]
            assert isinstance(value, float | bool), path["value"]


@pytest.mark.parametrize(
    ("end", "level", "text"),
    [("time limit", "INFO", "end: time limit"), ("tipped", "WARNING", "fell: tipped")],
)
def test_the_log_tells_how_it_ended(trot, read_back, end, level, text):
    (start, reset), (stop, final) = read_back(slice_steps(trot, 0, 10), end=end, episode=4)["/log"]
    assert (start, reset.message) == (0, "reset: episode 4, seed 0")
    assert (stop, final.message) == (200_000_000, text)
    assert final.Level.Name(final.level) == level


def test_no_step_at_all(trot, read_back):
    states = ("/robot_description", "/tf", "/joint_states", "/pose", "/scene", "/base_velocity")
    counts = {topic: len(of) for topic, of in read_back(slice_steps(trot, 0, 0)).items()}
    assert counts == {**dict.fromkeys((*states, "/imu"), 1), "/log": 2}


def test_a_command_has_its_channel(trot, read_back):
    commands = np.random.default_rng(0).normal(size=(trot.steps, 3))
    actual = read_back(command=commands)["/command"]
    assert [when for when, _ in actual] == [k * 20_000_000 for k in range(trot.steps)]
    values = [(m.forward, m.lateral, m.yaw_rate) for _, m in actual]
    np.testing.assert_allclose(values, commands, **CLOSE)


def test_any_observation_names_become_fields(read_back):
    names = ["timestamp", "a b", "a-b", "", "3rd", "é", *(f"n{k}" for k in range(41))]
    message = read_back(observation_names=tuple(names))["/observation"][0][1]
    fields = [field.name for field in message.DESCRIPTOR.fields]
    assert fields[:7] == ["timestamp", "timestamp_2", "a_b", "a_b_2", "value", "_3rd", "value_2"]


# Whole or absent


def test_another_process_writes_the_same_bytes(episode_file, trot, quadruped, tmp_path):
    # Another hash seed, start and order of what is given: nothing of these may show in the file.
    attached = {"big.txt": b"x" * 50_000, "config.json": b"{}"}
    arguments = (tmp_path / "b.mcap", trot, dict(reversed(METADATA.items())), attached)
    (tmp_path / "given").write_bytes(pickle.dumps(arguments))
    script = """
import pickle, sys
from quadwalk.evaluation.mcap.write import write_mcap
from quadwalk.robot.quadruped import load_quadruped
path, rollout, *others = pickle.load(open(sys.argv[1], "rb"))
write_mcap(path, rollout, load_quadruped(), *others)
"""
    environment = os.environ | {"PYTHONHASHSEED": "12345", "TZ": "Asia/Tokyo"}
    command = [sys.executable, "-c", script, str(tmp_path / "given")]
    subprocess.run(command, check=True, env=environment)
    assert (tmp_path / "b.mcap").read_bytes() == episode_file.read_bytes()


@pytest.mark.parametrize("older", [True, False])
@pytest.mark.parametrize("error", [ValueError("boom"), KeyboardInterrupt(), MemoryError()])
def test_an_interrupted_write_leaves_what_was_there(
    episode_file, trot, quadruped, tmp_path, monkeypatch, error, older
):
    path = tmp_path / "a.mcap"
    if older:
        shutil.copy(episode_file, path)

    def add_message(self, *_, **__):
        raise error

    monkeypatch.setattr(writing.Writer, "add_message", add_message)
    with pytest.raises(type(error)):
        write_mcap(path, trot, quadruped, {})
    assert os.listdir(tmp_path) == ["a.mcap"] * older
    assert not older or path.read_bytes() == episode_file.read_bytes()


def test_what_cannot_be_written_is_one_line(trot, quadruped, tmp_path):
    path = tmp_path / "missing" / "a.mcap"
    with pytest.raises(UserError) as caught:
        write_mcap(path, trot, quadruped, {})
    assert str(caught.value) == f"cannot write {path}: No such file or directory"


@pytest.fixture(scope="module")
def stand(simulate, quadruped, tmp_path_factory) -> tuple[Rollout, Path]:
    """Return a rollout of a robot on a stand, and its recording."""
    rollout = simulate(260)
    qpos = rollout.qpos.copy()
    qpos[:, :7] = quadruped.home[:7]
    rollout = dataclasses.replace(rollout, qpos=qpos, foot_force=np.zeros((260, 4)))
    path = tmp_path_factory.mktemp("stand") / "stand.mcap"
    write_mcap(path, rollout, quadruped, METADATA)
    return rollout, path


def test_identification_reads_targets_and_angles_of_a_robot_on_a_stand(
    stand, episode_file, quadruped
):
    rollout, path = stand
    with pytest.raises(UserError, match=r"the trunk moves by .* m; expected a robot on a stand"):
        read_log(episode_file, quadruped.joints)
    log = read_log(path, quadruped.joints)
    np.testing.assert_allclose(log.time, rollout.time, atol=1e-9)
    np.testing.assert_allclose(log.target_time, rollout.time[:-1], atol=1e-9)
    np.testing.assert_allclose(log.position, rollout.qpos[:, 7:], **CLOSE)
    np.testing.assert_allclose(log.target, rollout.target, **CLOSE)
    with pytest.raises(UserError, match="/joint_states has no left_hip; expected"):
        read_log(path, ("left_hip",) * 12)


def test_a_damaged_file_is_refused_or_read_as_it_was_written(stand, quadruped, tmp_path):
    good, bad = stand[1].read_bytes(), tmp_path / "bad.mcap"
    log = read_log(stand[1], quadruped.joints)
    rng = np.random.default_rng(0)
    refused = 0
    for kind in ["flip", "cut", "fill"] * 20:
        data, place = bytearray(good), int(rng.integers(len(good)))
        if kind == "flip":
            data[place] ^= 1 << int(rng.integers(8))
        elif kind == "cut":
            del data[place:]
        else:
            data[place : place + 20] = rng.bytes(20)
        bad.write_bytes(data)
        try:
            read = read_log(bad, quadruped.joints)
        except UserError:
            refused += 1
        else:
            for actual, expected in zip(read[:4], log[:4], strict=True):
                np.testing.assert_array_equal(actual, expected, f"{kind} at {place}")
    assert refused > 30  # the others hit what is not read, or metadata of the same content


# Other people's readers


def test_rerun_finds_nothing_wrong(episode_file):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    rerun = find_program("rerun")
    if shutil.which(rerun) is None:
        pytest.skip("needs the rerun command (rerun-sdk)")
    command = [rerun, "mcap", "check", str(episode_file)]
    checked = subprocess.run(command, capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_rerun_has_a_layout_for_what_is_recorded(episode_file, read_back, trot, tmp_path):
    layout = pytest.importorskip("benchmarks.rerun_blueprint", reason="needs rerun-sdk")
    actual = read_back(dataclasses.replace(trot, command=np.zeros((trot.steps, 3))))
    for plotted in (layout.SPEEDS, layout.REWARDS, layout.FEET):
        for topic, fields in plotted.items():
            _, first = actual[topic][0]
            message = first.DESCRIPTOR
            assert message.full_name == layout.MESSAGES[topic]
            assert set(fields) <= set(message.fields_by_name)
    assert layout.make_blueprint()
    recording = tmp_path / "an episode.mcap"
    shutil.copy(episode_file, recording)
    shutil.copy(RERUN_BLUEPRINT, tmp_path)
    convert, _, show = format_rerun_commands(recording).partition(" && ")
    subprocess.run(shlex.split(convert), check=True, capture_output=True)
    rerun, *files = shlex.split(show)
    assert [Path(file).name for file in files] == ["an episode.rrd", "rerun.rbl"]
    subprocess.run([rerun, "rrd", "verify", *files], check=True, capture_output=True)
    for file, kind in zip(files, ("Recording", "Blueprint"), strict=True):
        done = subprocess.run([rerun, "rrd", "print", file], capture_output=True, text=True)
        stores = re.findall(r'(\w+),\s+"([^"]+)",\s+"[^"]+",\s+\)', done.stdout)
        assert set(stores) == {(kind, "quadwalk")}


def test_rerun_decodes_what_was_simulated(episode_file, trot, quadruped):
    chunk = pytest.importorskip("rerun.chunk", reason="needs rerun-sdk with rerun.chunk")
    tables: dict[str, list] = {}
    geometry = set()
    for piece in chunk.McapReader(str(episode_file)).stream():
        if "visual_geometries" in piece.entity_path:
            geometry.add(piece.entity_path.split("/")[3])
        elif not piece.is_static:
            tables.setdefault(piece.entity_path, []).extend(piece.to_record_batch().to_pylist())
    assert {"trunk", "FR_calf", "RL_foot"} <= geometry  # the robot is drawn

    def transforms(link: str, kind: str) -> np.ndarray:
        rows = [row for row in tables["/tf"] if row["Transform3D:child_frame"] == [link]]
        return np.array([row[f"Transform3D:{kind}"][0] for row in rows])

    np.testing.assert_allclose(transforms("trunk", "translation"), trot.qpos[:, :3], rtol=1e-6)
    _, y, _, w = transforms("FR_calf", "quaternion").T
    np.testing.assert_allclose(2 * np.arctan2(y, w), trot.qpos[:, 9], atol=1e-5)

    states = [row["foxglove.JointStates:message"][0]["joints"] for row in tables["/joint_states"]]
    for key, expected in (("position", trot.qpos[:, 7:]), ("velocity", trot.qvel[:, 6:])):
        read_back = [[joint[key] for joint in joints] for joints in states]
        np.testing.assert_allclose(read_back, expected, **CLOSE)
    effort = [[joint["effort"] for joint in joints] for joints in states]
    assert effort[0] == [None] * 12
    np.testing.assert_allclose(effort[1:], trot.torque, **CLOSE)

    rewards = [row["quadwalk.Reward:message"][0] for row in tables["/reward"]]
    for name, values in {"total": trot.reward, **trot.reward_terms}.items():
        np.testing.assert_allclose([reward[name] for reward in rewards], values, **CLOSE)
    contacts = [row["quadwalk.Contacts:message"][0] for row in tables["/contacts"]]
    flags = [[contact[leg] for leg in quadruped.legs] for contact in contacts]
    np.testing.assert_array_equal(flags, trot.contact)
    assert [row["TextLog:level"] for row in tables["/log"]] == [["INFO"], ["INFO"]]


def test_rerun_draws_a_robot_of_meshes(trot, meshed, tmp_path):
    chunk = pytest.importorskip("rerun.chunk", reason="needs rerun-sdk with rerun.chunk")
    write_mcap(tmp_path / "meshed.mcap", trot, meshed, {})
    shapes = ("Boxes3D:half_sizes", "Cylinders3D:radii", "Ellipsoids3D:half_sizes")
    entities = {
        piece.entity_path.split("/")[3]
        for piece in chunk.McapReader(str(tmp_path / "meshed.mcap")).stream()
        if "visual_geometries" in piece.entity_path
        and not set(piece.to_record_batch().schema.names).isdisjoint(shapes)
    }
    assert {"trunk", "FR_hip"} <= entities


def test_foxgloves_own_reader_decodes_every_channel(episode_file, messages, trot, quadruped):
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node")
    packages = "require.resolve('@mcap/core'); require.resolve('@mcap/support')"
    here = Path(__file__).parent
    if subprocess.run([node, "-e", packages], cwd=here, capture_output=True).returncode:
        pytest.skip("needs npm install --no-save @mcap/core @mcap/support")
    command = [node, "read_mcap.cjs", str(episode_file)]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    actual = json.loads(done.stdout)
    topics = actual["topics"]
    assert {topic: of["count"] for topic, of in topics.items()} == {
        topic: len(of) for topic, of in messages.items()
    }
    assert topics["/robot_description"]["last"]["data"] == draw_urdf(
        quadruped.urdf, quadruped.make_full_model()
    )
    assert topics["/tf"]["time"] == str(trot.steps * 20_000_000)
    joints = topics["/joint_states"]["last"]["joints"]
    np.testing.assert_allclose([j["position"] for j in joints], trot.qpos[-1, 7:], **CLOSE)
    np.testing.assert_allclose([j["effort"] for j in joints], trot.torque[-1], **CLOSE)
    for name, values in trot.reward_terms.items():
        np.testing.assert_allclose(topics["/reward"]["last"][name], values[-1], **CLOSE)
    assert [topics["/contacts"]["last"][leg] for leg in quadruped.legs] == trot.contact[-1].tolist()
    assert actual["metadata"]["quadwalk"] == METADATA
    assert "foxglove_layout.json" in actual["attachments"]
