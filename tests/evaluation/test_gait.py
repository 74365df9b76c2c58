"""Footfalls and figures against patterns whose answers are known."""

import dataclasses
import json

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadwalk.evaluation.gait import (
    GAITS,
    analyze_footfalls,
    average_phases,
    flatten_gait,
    measure_gait,
    measure_phase_distance,
    name_gait,
    remove_chatter,
)
from quadwalk.evaluation.report.tables import describe_gait
from quadwalk.evaluation.rollout import slice_steps

DT = 0.02

# Ideal phases of FR, FL, RR, RL, in strides, and a usual duty factor.
IDEAL = {
    "walk, lateral sequence": ("walk", (0.0, 0.5, 0.75, 0.25), 0.7),
    "walk, diagonal sequence": ("walk", (0.0, 0.5, 0.25, 0.75), 0.7),
    "amble": ("walk", (0.0, 0.5, 0.75, 0.25), 0.4),
    "trot": ("trot", (0.0, 0.5, 0.5, 0.0), 0.5),
    "running trot": ("trot", (0.0, 0.5, 0.5, 0.0), 0.3),
    "pace": ("pace", (0.0, 0.5, 0.0, 0.5), 0.45),
    "bound": ("bound", (0.0, 0.0, 0.5, 0.5), 0.3),
    "pronk": ("pronk", (0.0, 0.0, 0.0, 0.0), 0.3),
    "transverse gallop": ("gallop", (0.0, 0.2, 0.5, 0.7), 0.3),
    "rotary gallop": ("gallop", (0.0, 0.2, 0.7, 0.5), 0.3),
    "gallop in quarters": ("gallop", (0.0, 0.25, 0.5, 0.75), 0.3),
    "half-bound": ("gallop", (0.0, 0.2, 0.5, 0.5), 0.3),
}


def make_pattern(phase, duty, frequency=2.0, seconds=6.0, dt=DT, jitter=0.0, seed=0) -> np.ndarray:
    """Return contacts (T, 4): each foot is down for `duty` of each stride, from its phase on."""
    rng = np.random.default_rng(seed)
    times = (np.arange(round(seconds / dt)) + 1) * dt
    contact = np.zeros((len(times), 4), dtype=bool)
    for foot in range(4):
        for stride in range(-1, int(seconds * frequency) + 2):
            start = (stride + phase[foot] + jitter * rng.standard_normal()) / frequency
            contact[:, foot] |= (times >= start) & (times < start + duty / frequency)
    return contact


@pytest.mark.parametrize("name", IDEAL)
@pytest.mark.parametrize("frequency", [1.5, 2.0, 3.1])
def test_every_gait_is_named(name, frequency):
    gait, phase, duty = IDEAL[name]
    feet = analyze_footfalls(make_pattern(phase, duty, frequency), DT)
    assert feet.gait == gait
    assert feet.stride_frequency == pytest.approx(frequency, rel=0.03)
    np.testing.assert_allclose(feet.duty_factor, duty, atol=0.05)
    for actual, ideal in zip(feet.phase, phase, strict=True):
        assert measure_phase_distance(actual, ideal) < 0.04
    assert feet.regularity.min() > 0.95


@pytest.mark.parametrize("name", IDEAL)
def test_gaits_keep_their_name_through_scatter_and_mirrored(name):
    gait, phase, duty = IDEAL[name]
    scattered = make_pattern(phase, duty, seconds=20, jitter=0.03)
    mirrored = make_pattern(np.array(phase)[[1, 0, 3, 2]], duty)
    assert [analyze_footfalls(actual, DT).gait for actual in (scattered, mirrored)] == [gait] * 2


def replace_foot(foot: int, contact) -> np.ndarray:
    """Return a trot with the contacts of one foot replaced."""
    actual = make_pattern((0, 0.5, 0.5, 0), 0.5)
    actual[:, foot] = contact
    return actual


IRREGULAR = {
    "at random": make_pattern((0, 0.5, 0.5, 0), 0.4, seconds=20, jitter=0.4),
    "at twice the pace": replace_foot(3, make_pattern((0,) * 4, 0.5, frequency=4.0)[:, 3]),
    "at half the pace": replace_foot(3, make_pattern((0,) * 4, 0.25, frequency=1.0)[:, 3]),
    "never lifted": replace_foot(2, True),
    "standing still": np.ones((100, 4), dtype=bool),
    "no row": np.zeros((0, 4), dtype=bool),
    "one row": np.zeros((1, 4), dtype=bool),
    "one stride": make_pattern((0, 0.5, 0.5, 0), 0.5, seconds=0.9),
}


@pytest.mark.parametrize("case", IRREGULAR)
def test_what_is_no_gait_is_irregular(case):
    feet = analyze_footfalls(IRREGULAR[case], DT)
    assert feet.gait == "irregular"
    if case in ("standing still", "no row", "one row"):
        assert np.isnan(feet.stride_frequency)
    if case == "standing still":
        assert feet.duty_factor.tolist() == [1, 1, 1, 1]
    if case == "never lifted":
        assert feet.duty_factor[2] == 1


@pytest.mark.parametrize("foot", range(4))
def test_a_foot_that_never_lands(foot):
    feet = analyze_footfalls(replace_foot(foot, False), DT)
    assert feet.gait == "irregular"
    assert feet.duty_factor[foot] == 0
    assert feet.stride_frequency == pytest.approx(2.0, rel=0.03)
    assert foot == 0 or np.isnan(feet.phase[foot])


@pytest.mark.parametrize(
    ("down", "reach", "every"), [(True, 1, 7), (False, 2, 5)], ids=["chatter", "brush"]
)
def test_chatter_is_not_a_stride_nor_a_brush_in_the_swing_a_touchdown(down, reach, every):
    contact = make_pattern((0, 0.5, 0.5, 0), 0.6 if down else 0.4)
    disturbed = contact.copy()
    for foot in range(4):
        same = contact[:, foot] == down
        rows = range(reach, len(same) - reach)
        inner = [k for k in rows if same[k - reach : k + reach + 1].all()]
        disturbed[inner[::every], foot] = not down
    assert (disturbed != contact).any()
    np.testing.assert_array_equal(remove_chatter(disturbed, DT), contact)
    assert analyze_footfalls(disturbed, DT).stride_frequency == pytest.approx(2.0, rel=0.03)


def test_short_contacts_of_every_stride_are_no_brushes():
    # A gallop of 6.25 strides a second, 8 rows each, with feet down for one or two of them.
    stride = np.zeros((8, 4), dtype=bool)
    for foot, rows in enumerate([(0, 1), (7,), (4, 5), (5, 6)]):
        stride[rows, foot] = True
    contact = np.tile(stride, (30, 1))
    np.testing.assert_array_equal(remove_chatter(contact, DT), contact)
    feet = analyze_footfalls(contact, DT)
    assert (feet.gait, feet.stride_frequency) == ("gallop", pytest.approx(6.25))
    np.testing.assert_allclose(feet.duty_factor, np.array([2, 1, 2, 2]) / 8)


def test_a_fine_clock_closes_longer_gaps():
    foot = np.array([1, 1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1], dtype=bool)
    cleaned = remove_chatter(np.tile(foot[:, None], 4), 0.004)
    assert cleaned[:8, 0].all()  # 16 ms off the ground
    assert not cleaned[8:16].any()  # 32 ms


@given(st.integers(0, 2**32 - 1), st.integers(0, 60), st.sampled_from([0.004, 0.02, 0.05]))
@settings(max_examples=100, deadline=None)
def test_any_contacts_give_figures_in_their_ranges(seed, rows, dt):
    rng = np.random.default_rng(seed)
    contact = rng.random((rows, 4)) < rng.random()
    feet = analyze_footfalls(contact, dt)
    assert feet.gait in GAITS
    assert np.isnan(feet.stride_frequency) or feet.stride_frequency > 0
    for values, most in ((feet.duty_factor, 1), (feet.phase, 1), (feet.regularity, 1.0000001)):
        finite = values[np.isfinite(values)]
        assert np.all((finite >= 0) & (finite <= most))


@given(st.lists(st.floats(0, 1), min_size=4, max_size=4), st.floats(0, 1))
@settings(max_examples=200, deadline=None)
def test_a_name_does_not_depend_on_where_the_stride_begins(phase, shift):
    phase = np.array(phase)
    lags = [measure_phase_distance(a, b) for a in phase for b in phase]
    edges = np.abs(np.array(lags)[:, None] - np.array([1 / 8, 3 / 8, 0.5, 0])).min()
    if edges > 1e-6:  # at an edge rounding decides
        assert name_gait(phase) == name_gait((phase + shift) % 1)


@given(st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=9), st.floats(0, 1))
@settings(max_examples=200, deadline=None)
def test_the_circular_mean_turns_with_its_phases(phases, shift):
    mean, length = average_phases(np.array(phases))
    shifted_mean, same = average_phases((np.array(phases) + shift) % 1)
    assert same == pytest.approx(length, abs=1e-9)
    assert 0 <= mean < 1
    if length > 1e-3:
        assert measure_phase_distance(shifted_mean, mean + shift) < 1e-6


# The figures of an episode


@pytest.fixture(scope="module")
def glide(simulate, quadruped):
    """Return a function that makes a gliding body's rollout, by default with a trot's footfalls."""
    base = simulate(300)

    def draw(velocity=(2.0, 0.0), yaw_rate=0.0, contact=None, steps=300, **changes):
        rollout = slice_steps(base, 0, steps)
        time = rollout.time
        qpos = np.tile(quadruped.home, (steps + 1, 1))
        qpos[:, 0], qpos[:, 1] = velocity[0] * time, velocity[1] * time
        qpos[:, 3], qpos[:, 6] = np.cos(yaw_rate * time / 2), np.sin(yaw_rate * time / 2)
        qvel = np.zeros((steps + 1, 18))
        qvel[:, :2], qvel[:, 5] = velocity, yaw_rate
        if contact is None:
            contact = make_pattern((0, 0.5, 0.5, 0), 0.5)[:steps]
        return dataclasses.replace(rollout, qpos=qpos, qvel=qvel, contact=contact, **changes)

    return draw


def test_speed_distance_and_drift(glide, quadruped):
    backwards = measure_gait(glide(velocity=(-1.0, 0.0)), quadruped)
    assert backwards.speed == pytest.approx(-1.0)
    assert np.isnan(backwards.cost_of_transport)
    gait = measure_gait(glide(velocity=(2.0, -0.5), yaw_rate=-1.5), quadruped)
    assert gait.duration == pytest.approx(6.0)
    assert gait.distance == pytest.approx(12.0)
    assert gait.speed == pytest.approx(2.0)
    assert gait.lateral_drift == pytest.approx(3.0)
    assert gait.heading_drift == pytest.approx(-9.0)  # more than a whole turn
    assert gait.stride_frequency == pytest.approx(2.0, rel=0.03)
    assert gait.stride_length == pytest.approx(np.hypot(2.0, 0.5) / 2, rel=0.03)
    assert gait.gait == "trot"
    assert not gait.fell


def test_froude_number_and_cost_of_transport(glide, quadruped):
    rollout = glide(energy=np.full(300, 1.5))
    gait = measure_gait(rollout, quadruped)
    # The thigh joint stands cos(.8) * .5 m above the foot's center, .0265 m above the ground.
    assert gait.froude == pytest.approx(4 / (9.81 * (0.5 * np.cos(0.8) + 0.0265)), rel=1e-3)
    mass = sum(quadruped.make_full_model().body_mass)
    assert gait.cost_of_transport == pytest.approx(450 / (mass * 9.81 * 12.0), rel=1e-4)


def test_limits_are_fractions_of_the_motors(glide, quadruped):
    torque = np.zeros((300, 12))
    torque[::2] = -0.5 * quadruped.effort
    torque[7, 4] = quadruped.effort[4]
    rollout = glide(torque=torque)
    rollout.qvel[:, 6:] = 0.25 * quadruped.velocity
    rollout.qvel[9, 6 + 2] = -quadruped.velocity[2]
    gait = measure_gait(rollout, quadruped)
    np.testing.assert_allclose(gait.torque_peak, [0.5] * 4 + [1.0] + [0.5] * 7)
    np.testing.assert_allclose(gait.torque_mean[0], 0.25)
    np.testing.assert_allclose(gait.joint_speed_peak, [0.25] * 2 + [1.0] + [0.25] * 9)
    np.testing.assert_allclose(gait.joint_speed_mean[0], 0.25)


def test_slip_is_the_speed_of_a_dragged_foot(glide, quadruped):
    gait = measure_gait(glide(velocity=(0.3, 0.4), contact=np.ones((300, 4), bool)), quadruped)
    np.testing.assert_allclose(gait.slip, 0.5, rtol=1e-6)
    # 299 steps lie between two moments on the ground; the hips go as far as the feet.
    np.testing.assert_allclose(gait.slip_share, 299 / 300, rtol=1e-6)
    assert np.isnan(gait.swing_height).all()


def test_action_rate_is_the_root_mean_square(glide, quadruped):
    action = np.zeros((300, 12))
    action[1::2, 3] = 0.6  # one of twelve joints goes to and fro, .02 s a step
    gait = measure_gait(glide(action=action), quadruped)
    assert gait.action_rate == pytest.approx(0.6 / 0.02 / np.sqrt(12))


def test_a_foot_that_rolls_does_not_slip(glide, quadruped):
    rollout = glide(velocity=(0.0, 0.0), contact=np.ones((300, 4), bool))
    # The whole robot tips ahead slowly, as if rigid, while its feet roll on the ground under it.
    model = quadruped.make_full_model()
    data = mujoco.MjData(model)
    for row, angle in enumerate(0.1 * rollout.time):
        qpos = rollout.qpos[row]
        qpos[3:7] = np.cos(angle / 2), 0, np.sin(angle / 2), 0
        qpos[:3] = 0
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        # One foot's center rolls: it moves ahead by the radius times the angle.
        qpos[:3] = np.array([0.0265 * angle, 0, 0.0265]) - data.geom("FR_foot").xpos
    gait = measure_gait(rollout, quadruped)
    assert gait.slip[0] == pytest.approx(0.0, abs=1e-5)
    assert gait.slip[2] < 1e-5 or gait.slip[2] > 1e-3  # hind feet leave the plane, by geometry


def test_swing_height_is_the_soles_greatest_height(glide, quadruped):
    rollout = glide()
    for row in range(301):  # the body, and all feet with it, up by 5 cm in swings of FR
        rollout.qpos[row, 2] += 0.05 * (row > 0 and not rollout.contact[row - 1, 0])
    gait = measure_gait(rollout, quadruped)
    assert gait.swing_height[0] == pytest.approx(0.05, abs=1e-4)
    assert gait.body_height[2] - gait.body_height[1] == pytest.approx(0.05)


def test_the_lowest_tenth_of_swings(glide, quadruped):
    rollout = glide()
    number, heights = -1, np.linspace(0.01, 0.10, 12)
    for row in range(1, 301):  # FR swings higher each time
        swings = not rollout.contact[row - 1, 0]
        number += swings and (row == 1 or rollout.contact[row - 2, 0])
        rollout.qpos[row, 2] += heights[number] * swings
    gait = measure_gait(rollout, quadruped)
    # Those between two contacts: without the last, which does not land.
    whole = heights[: number + rollout.contact[-1, 0]]
    assert gait.swing_height[0] == pytest.approx(np.median(whole), abs=1e-4)
    assert gait.swing_height_p10[0] == pytest.approx(np.percentile(whole, 10), abs=1e-4)


def test_slip_in_a_turn_on_the_spot_is_a_share_of_the_way_of_the_hips(glide, quadruped):
    """Check feet that turn with the trunk, all on the ground.

    They slide a little farther than the hips.
    """
    turning = glide(velocity=(0.0, 0.0), yaw_rate=1.0, contact=np.ones((300, 4), bool))
    share = measure_gait(turning, quadruped).slip_share
    model = quadruped.make_full_model()
    data = mujoco.MjData(model)
    data.qpos = quadruped.home
    mujoco.mj_kinematics(model, data)
    hips = [np.hypot(*data.joint(hip).xanchor[:2]) for hip in quadruped.joints[::3]]
    feet = [np.hypot(*data.geom(foot).xpos[:2]) for foot in quadruped.feet]
    np.testing.assert_allclose(share, 299 / 300 * np.array(feet) / np.mean(hips), rtol=1e-3)


def test_touch_down_speed_is_that_of_the_foot_before_it_touches(glide, quadruped):
    rollout = glide(velocity=(0.3, 0.0))
    for row in range(301):  # all feet sink at 0.5 m/s while FR swings
        if row > 1 and not rollout.contact[row - 1, 0] and not rollout.contact[row - 2, 0]:
            rollout.qpos[row, 2] = rollout.qpos[row - 1, 2] - 0.5 * 0.02
    speeds = measure_gait(rollout, quadruped).touchdown_speed
    assert speeds[0] == pytest.approx(np.hypot(0.3, 0.5), rel=1e-3)
    assert speeds[1] == pytest.approx(0.3, rel=1e-3)


def test_torque_reversals_are_changes_of_its_sign(glide, quadruped):
    torque = np.ones((300, 12))
    torque[1::2, 3] = -1.0
    torque[::3, 5] = 0.0
    reversals = measure_gait(glide(torque=torque), quadruped).torque_reversals
    np.testing.assert_allclose(reversals, np.eye(12)[3])


def test_roll_and_pitch_range(glide, quadruped):
    rollout = glide()
    quat = np.empty(4)
    for row in range(301):
        mujoco.mju_euler2Quat(quat, [0.2 * np.sin(row / 5), 0.1 * np.cos(row / 5), 0], "XYZ")
        rollout.qpos[row, 3:7] = quat
    gait = measure_gait(rollout, quadruped)
    assert gait.roll_range == pytest.approx(0.4, rel=0.02)
    assert gait.pitch_range == pytest.approx(0.2, rel=0.02)


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_a_fall_at_once(glide, quadruped, steps):
    gait = measure_gait(glide(steps=steps, end="tipped"), quadruped)
    assert (gait.fell, gait.end, gait.gait) == (True, "tipped", "irregular")
    assert gait.duration == pytest.approx(steps * 0.02)
    assert np.isnan(gait.stride_length)
    json.dumps(flatten_gait(gait, quadruped), allow_nan=False)


@pytest.mark.parametrize("steps", [0, 300])
def test_what_a_robot_that_stands_has_not_is_a_dash(glide, quadruped, steps):
    still = glide(velocity=(0.0, 0.0), contact=np.ones((steps, 4), bool), steps=steps)
    text = describe_gait(measure_gait(still, quadruped), 3)
    assert text.startswith("gait of episode 3: irregular, - strides/s of - m, duty factor ")
    assert (
        "slip up to - % of the way, feet at - m/s before touch-down, cost of transport -\n" in text
    )
    assert "nan" not in text


def test_metrics_are_flat_and_named(glide, quadruped):
    metrics = flatten_gait(measure_gait(glide(), quadruped), quadruped)
    assert metrics["gait"] == "trot"
    assert metrics["fell"] is False
    assert metrics["duty_factor.FL"] == pytest.approx(0.5, abs=0.03)
    assert metrics["phase.RL"] == pytest.approx(0.0, abs=0.03)
    assert set(metrics) >= {f"torque_peak.{joint}" for joint in quadruped.joints}
    assert metrics["body_height.mean"] == pytest.approx(0.375, abs=0.01)


def test_a_simulated_trot_is_called_a_trot(simulate, quadruped):
    gait = measure_gait(simulate(250), quadruped)
    assert gait.gait == "trot"
    assert gait.stride_frequency == pytest.approx(3.0, rel=0.05)
    assert 0.4 < gait.speed < 1.2
    assert np.all((gait.swing_height > 0.003) & (gait.swing_height < 0.1))
    assert np.all(gait.slip < 1.0)
    assert np.all(gait.torque_peak <= 1.0 + 1e-6)
