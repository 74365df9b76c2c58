"""Reward terms by hand: a case and a limit of each."""

import inspect
import itertools
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from quadwalk.env import rewards
from quadwalk.env.rewards import compute_reward_terms, compute_total_reward
from quadwalk.env.state import Step, Strides, start_strides
from quadwalk.errors import UsageError
from quadwalk.physics.rotation import from_euler
from quadwalk.settings.terms import Reward
from quadwalk.tasks import walk

PARAMS = {
    "forward": {"max_speed": 1.0},
    "follow": {"width": 1.0},
    "follow_yaw_rate": {"width": 1.0},
    "track": {"width": 0.5, "share": 0.2},
    "drag": {"height": 1.0},
    "kneel": {"height": 0.04},
    "at_home": {"joints": 0.5, "height": 0.2},
    "crossed": {"margin": 0.05},
    "legs_in_trunk": {"margin": 0.02, "height": 1.0},
    "trot": {"stride": 20.0, "height": 0.06, "width": 0.04},
    "diagonal": {"height": 0.04},
    "cost_of_transport": {"slow": 0.25},
    "short_stride": {"frequency": 0.5, "increase": 0.2},
    "swing_error": {"low": 0.2, "high": 0.4},
    "slip_share": {"slow": 0.25},
    "flight": {"slow": 0.8},
    "crouch": {"slow": 0.8},
}


REST = jnp.zeros(19).at[2].set(0.375).at[3].set(1.0)


def make_step(**changes) -> Step:
    """Return a step of a robot that stands upright at the origin, with `changes`."""
    fields = {
        "dt": 0.02,
        "steps": jnp.zeros((), jnp.int32),
        "start": REST,
        "qpos": REST,
        "qvel": jnp.zeros(18),
        "action": jnp.zeros(12),
        "last_action": jnp.zeros(12),
        "power": jnp.zeros(()),
        "fell": jnp.zeros((), bool),
        "command": jnp.zeros(3),
        "start_soles": jnp.zeros((4, 3)),
        "soles": jnp.zeros((4, 3)),
        "start_contact": jnp.ones(4, bool),
        "contact": jnp.ones(4, bool),
        "lowest": jnp.full(2, 0.2),
        "strides": start_strides(),
    }
    return Step(**{**fields, **changes})


def make_moving_step(yaw: float, turn: float, velocity, command) -> Step:
    """Return a step with a trunk at `velocity` (2,), m/s, that turns by `turn` to `yaw`."""
    start = REST.at[3:7].set(from_euler(0.1, -0.2, yaw - turn))
    qpos = start.at[:2].add(0.02 * jnp.array(velocity)).at[3:7].set(from_euler(-0.1, 0.2, yaw))
    return make_step(start=start, qpos=qpos, command=jnp.array(command))


def make_sole_step(heights, velocities) -> Step:
    """Return a step with soles at `heights` (4,), m, after `velocities` (4,), m/s, along y."""
    soles = jnp.zeros((4, 3)).at[:, 2].set(jnp.array(heights))
    return make_step(start_soles=soles.at[:, 1].add(-0.02 * jnp.array(velocities)), soles=soles)


def make_slipping_step(command) -> Step:
    """Return a step in which three feet stay on the floor, and two of them slip."""
    return make_sole_step([0.0] * 4, [1.0, 9.0, -0.5, 0.0])._replace(
        start_contact=jnp.array([True, False, True, True]), command=jnp.array(command)
    )


def make_fidgeting_step(robot, command: float) -> Step:
    """Return a step with half of the joints 0.2 rad off home, at 2 rad/s, and one foot lifted.

    `command` is the pace ahead, m/s.
    """
    qpos = jnp.asarray(robot.home, jnp.float32).at[7:13].add(0.2)
    qvel = jnp.zeros(18).at[6:12].set(2.0)
    return make_step(
        start=qpos,
        qpos=qpos,
        qvel=qvel,
        contact=jnp.array([True, False, True, True]),
        command=jnp.zeros(3).at[0].set(command),
    )


def make_swinging_step(steps, heights, command) -> Step:
    """Return step number `steps` of an episode, with soles at `heights` (4,), m."""
    return make_sole_step(heights, [0.0] * 4)._replace(
        steps=jnp.asarray(steps), command=jnp.array(command)
    )


def make_landing_step(robot, landed, times=0.0, peaks=0.0, pace=0.0) -> Step:
    """Return a step in which the feet `landed` (4,), bool, touch down; the others stand.

    Their last touch-downs were `times` (4,) ago after the step, in units of sqrt(height / g), and
    their soles rose to `peaks` (4,), shares of the home height. The command is at `pace`, in units
    of sqrt(height * g).
    """
    unit = np.sqrt(robot.home_height / 9.81)
    strides = Strides(
        jnp.array(times) * unit * jnp.ones(4) - 0.02,
        jnp.array(peaks) * robot.home_height * jnp.ones(4),
        jnp.zeros(()),
    )
    command = jnp.zeros(3).at[1].set(pace * np.sqrt(robot.home_height * 9.81))
    return make_step(start_contact=~jnp.array(landed), strides=strides, command=command)


def make_turning_step(error: float) -> Step:
    """Return a step after a stride whose yaw rate was `error` rad/s off in the mean."""
    return make_step(strides=start_strides()._replace(yaw_rate_error=jnp.asarray(error)))


def turn_trunk(roll=0.0, pitch=0.0, yaw=0.0):
    return REST.at[3:7].set(from_euler(roll, pitch, yaw))


def turn_thighs(robot, angles: list[float]) -> Step:
    """Return a step of the robot in its home pose, but for its thighs, turned by `angles`, rad."""
    joints = robot.home_joints.reshape(4, 3) + np.outer(angles, [0.0, 1.0, 0.0])
    return make_step(qpos=REST.at[7:].set(joints.ravel()))


def make_standing_step(robot, share=1.0, bent=0.0, **angles) -> Step:
    """Return a step at a share of the home height, joints `bent` rad off, turned by `angles`."""
    side = jnp.tile(jnp.array([1, -1]), 6)
    qpos = jnp.asarray(robot.home, jnp.float32).at[3:7].set(turn_trunk(**angles)[3:7])
    qpos = qpos.at[2].mul(share).at[7:].add(bent * side)
    return make_step(start=qpos, qpos=qpos)


def roll_front_legs(right: float, left: float):
    """Return qpos with all legs straight down, the front ones rolled to the left, rad."""
    return REST.at[7].set(right).at[10].set(left)


# A step, or a function that makes it for a robot, and the term's value.
CASES = {
    "forward": (make_step(qpos=REST.at[0].set(0.01)), 0.5),
    "fall": (make_step(fell=jnp.ones((), bool)), 1.0),
    "yaw_error": (make_step(qpos=turn_trunk(yaw=-0.4)), 0.4),
    "energy": (lambda robot: make_step(power=jnp.asarray(0.5 * robot.weight)), 0.5),
    # At 0.6 m/s aside and a turn of 0.4 m/s for a foot, with 0.5 m/s of power over weight.
    "cost_of_transport": (
        lambda robot: make_step(
            power=jnp.asarray(0.5 * robot.weight),
            command=jnp.array([0.0, -0.6, -0.4 / robot.home_height]),
        ),
        0.5 / 1.25,
    ),
    "alive": (make_step(), 1.0),
    "lateral": (make_step(qpos=REST.at[1].set(-0.01)), 0.5),
    "offset": (make_step(qpos=REST.at[1].set(-0.25)), 0.25),
    "vertical": (make_step(qvel=jnp.zeros(18).at[2].set(-0.5)), 0.25),
    "tilt": (make_step(qpos=turn_trunk(pitch=0.3)), np.sin(0.3) ** 2),
    "roll_pitch_rate": (make_step(qvel=jnp.zeros(18).at[3:5].set(jnp.array([3.0, 4.0]) / 2)), 2.5),
    "action_rate": (make_step(action=jnp.full(12, 0.5), last_action=jnp.full(12, -0.5)), 1.0),
    "joint_speed": (make_step(qvel=jnp.zeros(18).at[6:12].set(-2.0)), 2.0),  # of half the joints
    "upright": (make_step(qpos=turn_trunk(roll=-np.pi / 2)), 0.25),
    # At half the height, and 60 degrees off: three quarters, squared.
    "raised": (lambda robot: make_standing_step(robot, share=0.5, pitch=np.pi / 3), 0.5 * 0.75**2),
    # Both front legs of 0.5 m are straight, the right one rolled to the left by 30 degrees.
    "crossed": (
        make_step(qpos=roll_front_legs(np.pi / 6, 0.0)),
        (0.05 - (0.051 + 0.0868) + (0.5 / 2 - 0.0868 * np.cos(np.pi / 6) - 0.051)) / 2,
    ),
    # The same leg reaches in from 0.051 + 0.0868 m to the right; its foot is 0.48 m below.
    "legs_in_trunk": (
        make_step(qpos=roll_front_legs(np.pi / 6, 0.0)),
        (0.051 + 0.0868 - 0.02 + 0.5 / 2 - 0.0868 * np.cos(np.pi / 6) - 0.051)
        * (1.0 - 0.0868 / 2 - 0.5 * np.cos(np.pi / 6))
        / 4,
    ),
    # One width low, twice one off in all joints, half of the cosine.
    "at_home": (
        lambda robot: make_standing_step(robot, share=0.8, bent=1.0, roll=np.pi / 3),
        0.5 * np.exp(-4.0 - 1.0),
    ),
    # It heads along world y, and so moves to its right; the command is 0.6 and 0.8 m/s off.
    "follow": (make_moving_step(np.pi / 2, 0.0, (0.5, 0.25), (-0.35, 0.3, 9.0)), np.exp(-1.0)),
    # Commanded 2.5 m/s: a width of 0.5 m/s and a fifth of that, and one off.
    "track": (make_moving_step(0.0, 0.0, (1.5, 1.0), (1.5, 2.0, 0.0)), np.exp(-1.0)),
    # Commanded 0.5 m/s, 0.3 m/s off.
    "approach": (make_moving_step(0.0, 0.0, (0.3, 0.4), (0.0, 0.4, 0.0)), 0.4 - 0.3),
    "yaw_rate_off": (make_turning_step(-1.5), 1.5),
    # 0.03 rad in 0.02 s are 1.5 rad/s, 1 more than commanded.
    "momentary_yaw_rate_off": (
        make_moving_step(0.0, 0.03, (9.0, 9.0), (9.0, 9.0, 0.5)),
        1.0,
    ),
    # Half of the joints 0.2 rad off home at 2 rad/s, one of four feet lifted.
    "fidget": (
        lambda robot: make_fidgeting_step(robot, command=0.0),
        0.5 * 0.2**2 + 0.01 * 0.5 * 2.0**2 + 0.1 / 4,
    ),
    # Past the half turn: 0.03 rad in 0.02 s are 1.5 rad/s, and twice the width of 1 off.
    "follow_yaw_rate": (
        make_moving_step(-np.pi + 0.01, 0.03, (9.0, 9.0), (9.0, 9.0, 3.5)),
        np.exp(-4.0),
    ),
    # Half as high as a swing should be, on the floor, on the floor at rest, high enough.
    "drag": (make_sole_step([0.5, 0.0, 0.0, 1.5], [1.0, -0.6, 0.0, 1.0]), (0.5 + 0.6) / 4),
    # The second foot has just landed.
    "slip": (make_slipping_step([0.0, 0.0, 0.0]), (1.0 + 0.5) / 4),
    "slip_share": (make_slipping_step([0.3, 0.4, 0.0]), (1.0 + 0.5) / 4 / (0.5 + 0.25)),
    # At the Froude speed 0.5 + 0.2 strides are due in a unit of time: FR lands after 0.7 of one, FL
    # after half of one, RR after more. RL stands.
    "short_stride": (
        lambda robot: make_landing_step(
            robot, [True, True, True, False], times=[1.0, 0.5 / 0.7, 9.0, 0.0], pace=1.0
        ),
        0.3 + 0.5,
    ),
    # FR lifts by three quarters of what is asked for, FL by enough, RR by half too much. RL stands.
    "swing_error": (
        lambda robot: make_landing_step(
            robot, [True, True, True, False], peaks=[0.15, 0.3, 0.6, 0.0]
        ),
        0.25 + 0.5,
    ),
    "flight": (
        lambda robot: make_landing_step(robot, [False] * 4, pace=0.2)._replace(
            contact=jnp.zeros(4, bool)
        ),
        0.75,
    ),
    # A fifth of its height is missing, at a quarter of the pace at which that is free.
    "crouch": (
        lambda robot: make_standing_step(robot, share=0.8)._replace(
            command=jnp.array([0.2 * robot.froude_speed, 0.0, 0.0])
        ),
        0.2 * 0.75,
    ),
    # The front feet are ahead, which is free. The hind thighs turn apart, as in a trot, and take
    # feet that hang 0.5 cos(0.8) m below with them: in the mean backward.
    "feet_behind": (
        lambda robot: turn_thighs(robot, [-0.5, -0.5, 0.5, -0.1]),
        0.5 * np.cos(0.8) * (np.sin(0.5) - np.sin(0.1)) / 4 / (0.5 * np.cos(0.8) + 0.0265),
    ),
    # Of knees and shins, whatever the trunk does: a quarter of the height that costs nothing.
    "kneel": (make_step(lowest=jnp.array([-0.3, 0.01])), 0.75),
    # A quarter of a stride in, FR and RL (the first and last of the four) are to be highest: one
    # is higher, one half a width short, and of those that belong on the floor one is a width off.
    "trot": (
        make_swinging_step(5, [0.09, 0.04, 0.0, 0.04], (0.5, 0.0, 0.0)),
        (np.exp(-0.25) + np.exp(-1.0) + 2.0) / 4,
    ),
    # FR is 6 cm up, FL not; RR and RL are even: 3 cm of 4.
    "diagonal": (make_sole_step([0.06, 0.0, 0.02, 0.02], [0.0] * 4), 0.75),
}
LIMITS = {
    "forward": (make_step(qpos=REST.at[0].set(9.0)), 1.0),  # max_speed of PARAMS
    "yaw_error": (make_step(qpos=turn_trunk(yaw=3.0)), 1.0),
    "track": (make_moving_step(0.0, 0.0, (1e6, 0.0), (0.0, 0.0, 0.0)), 0.0),
    "approach": (make_moving_step(0.0, 0.0, (1e6, 0.0), (0.0, 0.0, 0.0)), -1.0),
    "yaw_rate_off": (make_turning_step(3.0), 2.0),
    "momentary_yaw_rate_off": (make_moving_step(0.0, 0.0, (9.0, 9.0), (9.0, 9.0, 5.0)), 2.0),
    "fidget": (
        lambda robot: make_fidgeting_step(robot, command=0.1),
        0.0,
    ),  # only where it is to stand
    "energy": (make_step(power=jnp.asarray(1e9)), 20.0),
    "cost_of_transport": (make_step(power=jnp.asarray(1e9)), 10.0),
    "lateral": (make_step(qpos=REST.at[1].set(5.0)), 1.0),
    "offset": (make_step(qpos=REST.at[1].set(50.0)), 1.0),
    "vertical": (make_step(qvel=jnp.zeros(18).at[2].set(9.0)), 1.0),
    "roll_pitch_rate": (make_step(qvel=jnp.full(18, 90.0)), 4.0),
    "follow": (make_moving_step(0.0, 0.0, (1e6, 0.0), (0.0, 0.0, 0.0)), 0.0),
    "follow_yaw_rate": (make_moving_step(0.0, 3.1, (0.0, 0.0), (0.0, 0.0, 0.0)), 0.0),
    "drag": (make_sole_step([0.0] * 4, [1e6] * 4), 2.0),
    "slip": (make_sole_step([0.0] * 4, [1e6] * 4), 2.0),
    "slip_share": (make_slipping_step([0.0, 0.0, 0.0]), 0.0),  # soles may creep at a stand
    "short_stride": (lambda robot: make_landing_step(robot, [True] * 4), 4.0),
    "swing_error": (lambda robot: make_landing_step(robot, [True] * 4), 4.0),
    "flight": (make_step(command=jnp.array([0.0, 0.0, 9.0]), contact=jnp.zeros(4, bool)), 0.0),
    "crouch": (lambda robot: make_standing_step(robot, share=9.0), 0.0),
    "feet_behind": (
        lambda robot: turn_thighs(robot, [np.pi / 2] * 4),
        0.5 * np.cos(0.8) / (0.5 * np.cos(0.8) + 0.0265),
    ),
    "joint_speed": (make_step(qvel=jnp.full(18, 90.0)), 100.0),
    "upright": (make_step(qpos=turn_trunk(roll=np.pi)), 0.0),
    "raised": (lambda robot: make_standing_step(robot, share=9.0), 1.0),
    "at_home": (lambda robot: make_standing_step(robot, pitch=2.0), 0.0),
    "crossed": (make_step(qpos=roll_front_legs(np.pi / 2, -np.pi / 2)), 0.15),
    "legs_in_trunk": (make_step(qpos=roll_front_legs(np.pi / 2, 0.0)), 0.3 * (1 - 0.0868) / 4),
    "kneel": (make_step(lowest=jnp.array([0.3, -9.0])), 1.0),
    # Half a stride later it is the others' turn; at the command to stand, nobody's.
    "trot": (make_swinging_step(15, [9.0, 0.06, 0.06, 9.0], (0.0, 0.0, 0.1)), 0.5),
    "diagonal": (make_sole_step([0.0, 9.0, 9.0, 0.0], [0.0] * 4), 1.0),
}
# Both ahead, all of one side, all four.
NO_TROT = ([0.06, 0.06, 0.0, 0.0], [0.06, 0.0, 0.06, 0.0], [0.06] * 4)


ALL = {name: Reward(getattr(rewards, name), PARAMS.get(name), scale=1.0) for name in CASES}


def test_every_term_has_a_case():
    terms = {
        name
        for name, value in vars(rewards).items()
        if inspect.isfunction(value)
        and not name.startswith("_")
        and list(inspect.signature(value).parameters)[1:2] == ["step"]
    }
    assert terms == set(CASES)


@pytest.mark.parametrize(
    ("name", "case"), [(name, case) for cases in (CASES, LIMITS) for name, case in cases.items()]
)
def test_a_term_is_what_it_says_and_bounded(env, name, case):
    step, expected = case
    step = step(env.robot) if callable(step) else step
    assert float(ALL[name](env.robot, step)) == pytest.approx(expected, abs=1e-5)


def test_a_turn_on_the_spot_asks_for_the_strides_of_the_feet_speed(env):
    """At one rad per unit of time feet go as fast as at the Froude speed ahead, for the term."""
    robot, term = env.robot, ALL["short_stride"]
    ahead = make_landing_step(robot, [True] * 4, times=0.5, pace=1.0)
    turn = jnp.zeros(3).at[2].set(-np.sqrt(9.81 / robot.home_height))
    assert float(term(robot, ahead._replace(command=turn))) == pytest.approx(
        float(term(robot, ahead)), rel=1e-5
    )


def test_strides_count_time_and_height_from_touch_down_to_touch_down():
    """One foot lifts for three steps, up to 5 cm, and lands; the others stand."""
    strides = start_strides()
    heights = [0.0, 0.02, 0.05, 0.03, 0.0, 0.0, 0.01]
    actual = []
    for before, after in itertools.pairwise(heights):
        soles = jnp.zeros((4, 3)).at[1, 2].set(after)
        step = make_step(
            soles=soles,
            start_contact=jnp.ones(4, bool).at[1].set(before == 0.0),
            contact=jnp.ones(4, bool).at[1].set(after == 0.0),
            strides=strides,
        )
        strides = strides.advance(step)
        actual.append((float(strides.time[1]), float(strides.peak[1])))
    expected = [(0.02, 0.02), (0.04, 0.05), (0.06, 0.05), (0.0, 0.0), (0.02, 0.0), (0.04, 0.01)]
    np.testing.assert_allclose(actual, expected, atol=1e-6)
    # The others never landed, so their time is that of the episode.
    np.testing.assert_allclose(strides.time[jnp.array([0, 2, 3])], 6 * 0.02, atol=1e-6)
    assert not jnp.any(strides.peak[jnp.array([0, 2, 3])])


def test_the_mean_yaw_rate_error_of_a_stride_leaves_its_sway_out():
    """A trunk turns by 0.2 rad/s too fast, and sways by 1 rad/s at 2.5 strides a second."""
    strides = start_strides()
    actual = []
    for number in range(100):
        error = 0.2 + np.sin(2.0 * np.pi * number / 20)
        step = make_moving_step(0.0, 0.02 * (0.5 + error), (0.0, 0.0), (0.0, 0.0, 0.5))
        strides = strides.advance(step._replace(strides=strides))
        actual.append(float(strides.yaw_rate_error))
    stride = np.array(actual[-20:])
    assert stride.mean() == pytest.approx(0.2, abs=2e-3)
    # A lag of 0.3 s takes a sway at 5 pi rad/s down to a fifth.
    assert np.ptp(stride) / 2 == pytest.approx(1.0 / np.hypot(1.0, 0.3 * 5.0 * np.pi), rel=0.05)


@pytest.mark.parametrize("heights", NO_TROT)
def test_other_gaits_have_no_diagonal_pair_above_the_other(env, heights):
    assert float(ALL["diagonal"](env.robot, make_sole_step(heights, [0.0] * 4))) == pytest.approx(
        0.0
    )


def test_standing_still_costs_nothing(env):
    values = compute_reward_terms(ALL, env.robot, make_standing_step(env.robot))
    ones = ("alive", "follow", "follow_yaw_rate", "track", "trot", "upright", "raised", "at_home")
    expected = dict.fromkeys(values, 0.0) | dict.fromkeys(ones, 1.0)
    assert {name: float(value) for name, value in values.items()} == pytest.approx(
        expected, abs=1e-6
    )


def test_the_total_is_the_scaled_sum_and_a_scale_of_zero_drops_its_term(env):
    scales = {"forward": 2.0, "offset": -3.0, "energy": 0.0}
    terms = ALL | {name: replace(ALL[name], scale=scale) for name, scale in scales.items()}
    qpos = make_standing_step(env.robot).qpos.at[0].set(0.01).at[1].set(0.1)
    values = compute_reward_terms(terms, env.robot, make_step(qpos=qpos, start=qpos.at[0].set(0.0)))
    assert set(values) == set(ALL) - {"energy"}
    # forward 0.5 m/s, offset 0.1 m, alive 1; nothing else moves. At the command to stand, it is
    # 0.5 m/s off.
    followed = np.exp(-(0.5**2)) + 1 + 1 + np.exp(-1.0) - 0.5
    upright_raised_and_at_home = 1 + 1 + 1
    expected = 2 * 0.5 - 3 * 0.1 + 1 + followed + upright_raised_and_at_home
    assert float(compute_total_reward(terms, values)) == pytest.approx(expected, abs=1e-4)


def test_the_robots_weight_is_its_mass_times_gravity(env):
    assert env.robot.weight == pytest.approx(env.mj_model.body_mass.sum() * 9.81)
    assert 21.0 < env.robot.weight / 9.81 < 24.0


@pytest.mark.parametrize(
    "name", ["", "a b", "a/b", "a.b", "[red]", "$x$", "a\nb", "1a", "x" * 41, "-a", "<b>"]
)
def test_a_name_that_would_be_no_flag_heading_or_label_is_refused(name):
    (term, *_) = walk.TASK.env.reward.values()
    for group in ("reward", "observation", "critic", "termination"):
        with pytest.raises(UsageError, match=rf"^env\.{group}: a term cannot be called .*_, not"):
            replace(walk.TASK.env, **{group: {name: term}})
