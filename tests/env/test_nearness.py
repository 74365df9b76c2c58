"""The report on a robot before a policy of many bodies drives it."""

import dataclasses

import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.nearness import describe_robot, list_figures
from quadwalk.robot.bodies import make_body, sample_bodies
from quadwalk.settings.environment import BodiesConfig
from quadwalk.tasks import universal

CONFIG = dataclasses.replace(universal.TASK.env, bodies=BodiesConfig())


@pytest.fixture(scope="module")
def figures():
    return next(sample_bodies(1, 3))


def test_a_body_of_training_is_within_all_ranges(figures):
    env = QuadrupedEnv(make_body(figures), CONFIG)
    assert [figure.excess for figure in list_figures(env) if figure.excess] == []
    values = {figure.name: figure.value for figure in list_figures(env)}
    assert values["mass, kg"] == pytest.approx(figures.mass)
    assert values["thigh torque / (m g L)"] == pytest.approx(figures.effort, rel=1e-5)
    assert describe_robot(env)[-1] == "within the bodies trained on, figure by figure"


def test_what_is_beyond_the_bodies_of_training_is_named(figures):
    """Check thigh motors with 0.6 of the weakest torque, which is 0.2 m g L.

    Motors that are faster than in training do no harm.
    """
    weak = dataclasses.replace(figures, effort=0.6 * 0.2, speed=99.0, calf_effort=2.0)
    lines = describe_robot(QuadrupedEnv(make_body(weak), CONFIG))
    (row,) = [line for line in lines if line.startswith("thigh torque")]
    assert row.split()[-5:] == ["0.12", "0.2", "to", "more", "beyond"]
    assert "thigh torque / (m g L) 40 % less" in lines[-1]
    assert "speed" not in lines[-1]


def test_legs_home_pose_and_limits_are_told(quadruped):
    lines = describe_robot(QuadrupedEnv(quadruped, CONFIG))
    assert "legs FR FL RR RL" in lines[0]
    assert "front knees behind, hind knees behind" in lines[0]
    (calf,) = [line for line in lines if line.startswith("calf:")]
    assert f"at home {quadruped.home[9]:.3g} rad" in calf
    assert "44.4 Nm" in calf
