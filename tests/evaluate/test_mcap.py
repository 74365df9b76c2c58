"""MCAP files: read back by other people's readers, and whole or absent whatever goes wrong."""

import dataclasses
import gzip
import json
import os
import shutil
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from quadwalk.errors import UserError
from quadwalk.evaluate.recording import mcap as writing
from quadwalk.evaluate.recording.mcap import LAYOUT, verify_mcap, write_mcap
from quadwalk.evaluate.recording.messages import drawn_urdf
from quadwalk.evaluate.rollout import first_steps
from quadwalk.identify.joint_log import read_log

METADATA = {"version": "1.2.3", "config": '{"seed": 7}'}
SCENE_ROWS = [*range(0, 100, 3), 100]  # of 100 steps: each third state, and the last
CLOSE = {"rtol": 1e-6, "atol": 1e-12}


@pytest.fixture(scope="module")
def written(tmp_path_factory, trot, quadruped) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "episode.mcap"
    write_mcap(path, trot, quadruped, METADATA, {"config.json": b"{}", "big.txt": b"x" * 50_000})
    return path


@pytest.fixture(scope="module")
def messages(written) -> dict[str, list]:
    """topic -> [(nanoseconds, decoded message)], by the plain reader."""
    return read(written)


def read(path: Path) -> dict[str, list]:
    result: dict[str, list] = {}
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message in reader.iter_messages():
            assert message.publish_time == message.log_time
            result.setdefault(channel.topic, []).append((message.log_time, message.data))
        for topic in result:
            if topic != "/robot_description":
                result[topic] = [
                    (message.log_time, decoded)
                    for _, _, message, decoded in reader.iter_decoded_messages(topics=[topic])
                ]
    return result


# What the file says


def test_identification_reads_targets_and_angles_of_a_robot_on_a_stand(
    simulate, trot, written, quadruped, tmp_path
):
    with pytest.raises(UserError, match=r"the trunk moves by .* m; expected a robot on a stand"):
        read_log(written, quadruped.joints)
    long = simulate(260)
    held = long.qpos.copy()
    held[:, :7] = quadruped.home[:7]
    standing = dataclasses.replace(long, qpos=held, foot_force=np.zeros((260, 4)))
    write_mcap(tmp_path / "stand.mcap", standing, quadruped, METADATA)
    log = read_log(tmp_path / "stand.mcap", quadruped.joints)
    np.testing.assert_allclose(log.time, long.time, atol=1e-9)
    np.testing.assert_allclose(log.target_time, long.time[:-1], atol=1e-9)
    np.testing.assert_allclose(log.position, long.qpos[:, 7:], **CLOSE)
    np.testing.assert_allclose(log.target, long.target, **CLOSE)
    with pytest.raises(UserError, match="/joint_states has no left_hip; expected"):
        read_log(tmp_path / "stand.mcap", ("left_hip",) * 12)


def test_every_channel_and_its_times(messages, trot):
    steps, states = trot.steps, trot.steps + 1
    counts = {topic: len(found) for topic, found in messages.items()}
    assert counts == {
        "/robot_description": 1,
        "/tf": states,
        "/joint_states": states,
        "/joint_cmd": steps,
        "/pose": states,
        "/scene": len(SCENE_ROWS),
        "/log": 2,
        "/base_velocity": states,
        "/imu": states,
        "/contacts": steps,
        "/action": steps,
        "/observation": steps,
        "/reward": steps,
    }
    grid = [k * 20_000_000 for k in range(states)]
    for topic in ("/tf", "/joint_states", "/pose", "/base_velocity", "/imu"):
        assert [when for when, _ in messages[topic]] == grid
    for topic in ("/contacts", "/reward"):  # what a step produced
        assert [when for when, _ in messages[topic]] == grid[1:]
    for topic in ("/action", "/observation", "/joint_cmd"):  # what a step began with
        assert [when for when, _ in messages[topic]] == grid[:-1]


def test_embedded_times_are_the_log_times(messages):
    for topic, found in messages.items():
        if topic == "/robot_description":
            continue
        for when, message in found:
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
    drawn, whole = ElementTree.fromstring(text), ElementTree.fromstring(quadruped.urdf)
    assert whole.findall("link/collision")
    assert not drawn.findall("link/collision")
    for kept in ("joint", "link/visual", "link/inertial", "material"):
        found, expected = drawn.findall(kept), whole.findall(kept)
        assert [ElementTree.tostring(e).strip() for e in found] == [
            ElementTree.tostring(e).strip() for e in expected
        ]


def test_a_link_without_visuals_is_drawn_by_its_collision_shapes():
    urdf = "<robot name='r'><link name='a'><collision/></link></robot>"
    assert "<collision/>" in drawn_urdf(urdf)


def test_transforms_compose_to_the_simulators_poses(messages, trot, quadruped):
    model = quadruped.full_model()
    data = mujoco.MjData(model)
    for row in (0, 1, 37, trot.steps):
        frames = {"world": np.eye(4)}
        for transform in messages["/tf"][row][1].transforms:
            turn, move = transform.rotation, transform.translation
            matrix, local = np.empty(9), np.eye(4)
            mujoco.mju_quat2Mat(matrix, np.array([turn.w, turn.x, turn.y, turn.z]))
            local[:3, :3] = matrix.reshape(3, 3)
            local[:3, 3] = move.x, move.y, move.z
            frames[transform.child_frame_id] = frames[transform.parent_frame_id] @ local
        data.qpos[:] = trot.qpos[row]
        mujoco.mj_kinematics(model, data)
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
        found = [(each.parent_frame_id, each.child_frame_id) for each in message.transforms]
        assert len(found) == len(expected)
        assert set(found) == expected
        # A reader that goes through them once finds each parent before its children.
        placed = {"world"}
        for parent, child in found:
            assert parent in placed
            placed.add(child)


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
        np.testing.assert_allclose(
            [joint.position for joint in message.joints], trot.target[row], **CLOSE
        )


def test_typed_channels_name_each_quantity(messages, trot, quadruped):
    def column(topic: str, field: str) -> list:
        return [getattr(message, field) for _, message in messages[topic]]

    for k, joint in enumerate(quadruped.joints):
        np.testing.assert_allclose(column("/action", joint), trot.action[:, k], **CLOSE)
    for k, leg in enumerate(quadruped.legs):
        assert column("/contacts", leg) == trot.contact[:, k].tolist()
        np.testing.assert_allclose(
            column("/contacts", f"{leg}_force"), trot.foot_force[:, k], **CLOSE
        )
    for name, values in trot.reward_terms.items():
        np.testing.assert_allclose(column("/reward", name), values, **CLOSE)
    np.testing.assert_allclose(column("/reward", "total"), trot.reward, **CLOSE)
    for k in (0, 5, 46):
        np.testing.assert_allclose(
            column("/observation", f"seen_{k}"), trot.observation[:, k], **CLOSE
        )
    np.testing.assert_allclose(column("/base_velocity", "world_x"), trot.qvel[:, 0], **CLOSE)
    np.testing.assert_allclose(column("/pose", "pose")[3].position.z, trot.qpos[3, 2], **CLOSE)


def test_the_accelerometer_feels_gravity_at_rest(simulate, quadruped, tmp_path):
    still = simulate(60, sweep=0.0, lift=0.0)
    write_mcap(tmp_path / "still.mcap", still, quadruped, {})
    last = read(tmp_path / "still.mcap")["/imu"][-1][1]
    assert last.accelerometer_z == pytest.approx(9.81, abs=0.3)
    assert abs(last.accelerometer_x) < 0.3
    assert abs(last.roll) < 0.05
    assert abs(last.pitch) < 0.05


def test_body_velocity_is_turned_into_the_bodys_frame(trot, quadruped, tmp_path):
    qpos, qvel = trot.qpos.copy(), trot.qvel.copy()
    qpos[:, 3:7] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]  # facing left: world y is ahead
    qvel[:, :3] = [0, 2, 0]
    write_mcap(tmp_path / "a.mcap", dataclasses.replace(trot, qpos=qpos, qvel=qvel), quadruped, {})
    message = read(tmp_path / "a.mcap")["/base_velocity"][5][1]
    assert (message.body_x, message.body_y) == pytest.approx((2.0, 0.0), abs=1e-6)
    assert (message.world_x, message.world_y) == pytest.approx((0.0, 2.0), abs=1e-6)


def test_the_scene_is_complete_in_each_message(messages, trot, quadruped):
    model = quadruped.full_model()
    data = mujoco.MjData(model)
    for index, (_, message) in enumerate(messages["/scene"]):
        row = SCENE_ROWS[index]
        ground, path, velocity, forces = message.entities
        ids = [entity.id for entity in message.entities]
        assert ids == ["ground", "path", "velocity", "foot_forces"]
        assert {entity.frame_id for entity in message.entities} == {"world"}
        assert len(ground.lines[0].points) % 2 == 0
        last = path.lines[0].points[-1]
        assert (last.x, last.y) == pytest.approx(trot.qpos[row, :2], abs=1e-3)
        assert len(path.lines[0].points) <= 64
        (arrow,) = velocity.arrows
        turn, matrix = arrow.pose.orientation, np.empty(9)
        mujoco.mju_quat2Mat(matrix, np.array([turn.w, turn.x, turn.y, turn.z]))
        drawn = arrow.shaft_length * matrix.reshape(3, 3)[:, 0]  # an arrow points along x
        np.testing.assert_allclose(drawn, 0.25 * trot.qvel[row, :3], atol=2e-3)
        touching = np.flatnonzero(trot.contact[row - 1]) if row else []
        tails = [[getattr(arrow.pose.position, a) for a in "xyz"] for arrow in forces.arrows]
        assert len(tails) == len(touching)
        if tails:
            data.qpos[:] = trot.qpos[row]
            mujoco.mj_kinematics(model, data)
            feet = [data.site(quadruped.feet[foot]).xpos for foot in touching]
            np.testing.assert_allclose(tails, feet, atol=1e-3)


def test_metadata_and_attachments(written, quadruped):
    with open(written, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        attached = {record.name: record for record in reader.iter_attachments()}
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
def test_the_log_tells_how_it_ended(trot, quadruped, tmp_path, end, level, text):
    path = tmp_path / "a.mcap"
    write_mcap(path, dataclasses.replace(first_steps(trot, 10), end=end, episode=4), quadruped, {})
    (start, reset), (stop, final) = read(path)["/log"]
    assert (start, reset.message) == (0, "reset: episode 4, seed 0")
    assert (stop, final.message) == (200_000_000, text)
    assert final.Level.Name(final.level) == level


@pytest.mark.parametrize("row", [0, 1, 7, 100])
def test_a_state_that_is_not_finite_ends_the_recording(trot, quadruped, tmp_path, row):
    qpos, qvel = trot.qpos.copy(), trot.qvel.copy()
    qpos[row:, 2], qvel[row:] = np.nan, np.inf
    path = tmp_path / "a.mcap"
    write_mcap(path, dataclasses.replace(trot, qpos=qpos, qvel=qvel, end="nan"), quadruped, {})
    found = read(path)
    assert len(found.get("/tf", ())) == row
    when, last = found["/log"][-1]
    assert when == row * 20_000_000
    assert (
        last.message
        == "nan: qpos[2], qvel[0], qvel[1], qvel[2] and 15 more not finite, recording ends"
    )
    assert last.Level.Name(last.level) == "ERROR"


def test_no_step_at_all(trot, quadruped, tmp_path):
    write_mcap(tmp_path / "a.mcap", first_steps(trot, 0), quadruped, {})
    found = read(tmp_path / "a.mcap")
    assert {topic: len(of) for topic, of in found.items()} == {
        "/robot_description": 1,
        "/tf": 1,
        "/joint_states": 1,
        "/pose": 1,
        "/scene": 1,
        "/base_velocity": 1,
        "/imu": 1,
        "/log": 2,
    }


def test_a_command_has_its_channel(trot, quadruped, tmp_path):
    told = np.random.default_rng(0).normal(size=(trot.steps, 3))
    rollout = dataclasses.replace(trot, command=told)
    write_mcap(tmp_path / "told.mcap", rollout, quadruped, METADATA)
    found = read(tmp_path / "told.mcap")
    assert [when for when, _ in found["/command"]] == [k * 20_000_000 for k in range(trot.steps)]
    values = [(m.forward, m.lateral, m.yaw_rate) for _, m in found["/command"]]
    np.testing.assert_allclose(values, told, **CLOSE)


def test_any_observation_names_become_fields(trot, quadruped, tmp_path):
    names = ["timestamp", "a b", "a-b", "", "3rd", "é", *(f"n{k}" for k in range(41))]
    rollout = dataclasses.replace(trot, observation_names=tuple(names))
    write_mcap(tmp_path / "a.mcap", rollout, quadruped, {})
    message = read(tmp_path / "a.mcap")["/observation"][0][1]
    fields = [field.name for field in message.DESCRIPTOR.fields]
    assert fields[:7] == ["timestamp", "timestamp_2", "a_b", "a_b_2", "value", "_3rd", "value_2"]


# Size, time, memory


def test_another_process_writes_the_same_bytes(written, trot, quadruped, tmp_path):
    # Another hash seed, start and order of what is given: nothing of these may show in the file.
    source = tmp_path / "rollout.npz"
    arrays = {
        field.name: getattr(trot, field.name)
        for field in dataclasses.fields(trot)
        if isinstance(getattr(trot, field.name), np.ndarray)
    }
    np.savez(source, **arrays, **{f"term_{name}": v for name, v in trot.reward_terms.items()})
    script = f"""
import numpy as np
from quadwalk.evaluate.recording.mcap import write_mcap
from quadwalk.evaluate.rollout import Rollout
from quadwalk.robot.quadruped import load_quadruped
data = np.load({str(source)!r})
arrays = {{name: data[name] for name in data if not name.startswith("term_")}}
terms = {{name[5:]: data[name] for name in data if name.startswith("term_")}}
rollout = Rollout({trot.control_dt!r}, {trot.seed}, {trot.episode}, {trot.end!r}, **arrays,
                  observation_names={trot.observation_names!r}, reward_terms=terms)
write_mcap({str(tmp_path / "b.mcap")!r}, rollout, load_quadruped(),
           {dict(reversed(METADATA.items()))!r},
           {{"big.txt": b"x" * 50_000, "config.json": b"{{}}"}})
"""
    environment = os.environ | {"PYTHONHASHSEED": "12345", "TZ": "Asia/Tokyo"}
    subprocess.run([sys.executable, "-c", script], check=True, env=environment)
    assert (tmp_path / "b.mcap").read_bytes() == written.read_bytes()


def test_twenty_seconds_are_small_and_quick(simulate, quadruped, tmp_path):
    rollout = simulate(1000)
    path = tmp_path / "long.mcap"
    seconds = []
    for _ in range(3):
        start = time.process_time()
        write_mcap(path, rollout, quadruped, METADATA)
        seconds.append(time.process_time() - start)
    assert path.stat().st_size < 1_000_000
    assert min(seconds) < 1.0  # 0.3 on a quiet machine


def test_memory_does_not_grow_with_the_episode(trot, quadruped, tmp_path):
    def peak(repeats: int) -> int:
        changes = {
            field.name: np.concatenate([getattr(trot, field.name)] * repeats)
            for field in dataclasses.fields(trot)
            if isinstance(getattr(trot, field.name), np.ndarray)
        }
        for name in ("qpos", "qvel"):  # one state more than steps
            changes[name] = changes[name][: trot.steps * repeats + 1]
        terms = {name: np.tile(v, repeats) for name, v in trot.reward_terms.items()}
        rollout = dataclasses.replace(trot, **changes, reward_terms=terms)
        tracemalloc.start()
        try:
            write_mcap(tmp_path / "m.mcap", rollout, quadruped, {})
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    # Both are longer than a block of rows and a chunk of the file.
    assert peak(30) < 1.25 * peak(3)


# Whole or absent


@pytest.mark.parametrize("older", [True, False])
@pytest.mark.parametrize("error", [ValueError("boom"), KeyboardInterrupt(), MemoryError()])
def test_an_interrupted_write_leaves_what_was_there(
    written, trot, quadruped, tmp_path, monkeypatch, error, older
):
    path = tmp_path / "a.mcap"
    if older:
        shutil.copy(written, path)

    def add_message(self, *_, **__):
        raise error

    monkeypatch.setattr(writing.Writer, "add_message", add_message)
    with pytest.raises(type(error)):
        write_mcap(path, trot, quadruped, {})
    assert os.listdir(tmp_path) == ["a.mcap"] * older
    assert not older or path.read_bytes() == written.read_bytes()


def test_a_missing_folder_is_one_line(trot, quadruped, tmp_path):
    path = tmp_path / "missing" / "a.mcap"
    with pytest.raises(UserError) as caught:
        write_mcap(path, trot, quadruped, {})
    assert str(caught.value) == f"cannot write {path}: No such file or directory"


def test_damage_between_writing_and_naming_is_noticed(trot, quadruped, tmp_path, monkeypatch):
    original = writing._write

    def damaging(stream, *rest):
        count = original(stream, *rest)
        stream.seek(stream.tell() // 2)
        stream.write(b"\xff\x00\xff")
        return count

    monkeypatch.setattr(writing, "_write", damaging)
    with pytest.raises(UserError, match="damaged or incomplete MCAP"):
        write_mcap(tmp_path / "a.mcap", trot, quadruped, {})
    assert os.listdir(tmp_path) == []


def test_verification_finds_every_flipped_bit(written, tmp_path):
    good = written.read_bytes()
    path = tmp_path / "bad.mcap"
    rng = np.random.default_rng(0)
    places = {0, 9, len(good) - 1, len(good) - 10, len(good) - 40}
    places |= set(rng.integers(0, len(good), 100).tolist())
    assert verify_mcap(written) > 0
    for place in sorted(places):
        bad = bytearray(good)
        bad[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(bad)
        with pytest.raises(UserError, match=r"bad\.mcap: damaged or incomplete"):
            verify_mcap(path)


@pytest.mark.parametrize("keep", [0, 5, 100, 0.5, 0.99, -1])
def test_verification_finds_a_file_cut_short(written, tmp_path, keep):
    good = written.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(good[: int(keep * len(good)) if isinstance(keep, float) else keep])
    with pytest.raises(UserError, match="damaged or incomplete"):
        verify_mcap(path)


def test_verifying_nothing_is_one_line(tmp_path):
    with pytest.raises(UserError, match=r"^cannot read .*: No such file or directory$"):
        verify_mcap(tmp_path / "none.mcap")


# Other people's readers


@pytest.fixture(scope="module")
def rerun_command() -> str:
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    command = shutil.which("rerun", path=os.path.dirname(sys.executable)) or shutil.which("rerun")
    if command is None:
        pytest.skip("needs the rerun command (rerun-sdk)")
    return command


def test_rerun_finds_nothing_wrong(written, rerun_command):
    checked = subprocess.run(
        [rerun_command, "mcap", "check", str(written)], capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_rerun_decodes_what_was_simulated(written, trot, quadruped):
    chunk = pytest.importorskip("rerun.chunk", reason="needs rerun-sdk with rerun.chunk")
    tables: dict[str, list] = {}
    geometry = set()
    for piece in chunk.McapReader(str(written)).stream():
        if "visual_geometries" in piece.entity_path:
            geometry.add(piece.entity_path.split("/")[3])
        elif not piece.is_static:
            tables.setdefault(piece.entity_path, []).extend(piece.to_record_batch().to_pylist())
    assert {"trunk", "FR_calf", "RL_foot"} <= geometry  # the robot is drawn

    transforms = [row for row in tables["/tf"] if row["Transform3D:child_frame"] == ["trunk"]]
    assert len(transforms) == trot.steps + 1
    np.testing.assert_allclose(
        [row["Transform3D:translation"][0] for row in transforms], trot.qpos[:, :3], rtol=1e-6
    )
    knees = [row for row in tables["/tf"] if row["Transform3D:child_frame"] == ["FR_calf"]]
    angles = [
        2 * np.arctan2(row["Transform3D:quaternion"][0][1], row["Transform3D:quaternion"][0][3])
        for row in knees
    ]
    np.testing.assert_allclose(angles, trot.qpos[:, 9], atol=1e-5)

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


def test_foxgloves_own_reader_decodes_every_channel(written, messages, trot, quadruped):
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node")
    packages = "require.resolve('@mcap/core'); require.resolve('@mcap/support')"
    here = Path(__file__).parent
    if subprocess.run([node, "-e", packages], cwd=here, capture_output=True).returncode:
        pytest.skip("needs npm install --no-save @mcap/core @mcap/support")
    done = subprocess.run(
        [node, str(here / "read_mcap.cjs"), str(written)], cwd=here, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    topics = found["topics"]
    assert {topic: of["count"] for topic, of in topics.items()} == {
        topic: len(of) for topic, of in messages.items()
    }
    assert topics["/robot_description"]["last"]["data"] == drawn_urdf(quadruped.urdf)
    assert topics["/tf"]["time"] == str(trot.steps * 20_000_000)
    joints = topics["/joint_states"]["last"]["joints"]
    np.testing.assert_allclose([j["position"] for j in joints], trot.qpos[-1, 7:], **CLOSE)
    np.testing.assert_allclose([j["effort"] for j in joints], trot.torque[-1], **CLOSE)
    for name, values in trot.reward_terms.items():
        np.testing.assert_allclose(topics["/reward"]["last"][name], values[-1], **CLOSE)
    assert [topics["/contacts"]["last"][leg] for leg in quadruped.legs] == trot.contact[-1].tolist()
    assert found["metadata"]["quadwalk"] == METADATA
    assert "foxglove_layout.json" in found["attachments"]
