"""How a run of the gecko study moves: figures of its gait, and what a picture of it needs."""

from collections import Counter
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.gait import Gait, find_contacts, measure_gait, remove_chatter
from quadwalk.evaluation.load import load_run
from quadwalk.evaluation.metrics import find_typical_episode, to_roll_pitch_yaw
from quadwalk.evaluation.rollout import Rollout, simulate_episodes
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs.directory import Run
from quadwalk.runs.log import read_metrics

SECONDS = 1000 / 240  # s, the post's episode: that of all variants here
EPISODES = 8
STARTS = 0.05  # rad, the least by which their joints differ, for the post's starts are all alike
FRAMES, PICTURED = 6, 0.5  # states kept for pictures, over so many s in the middle
SHOWN = 2.0  # s of footfalls kept, at the end


def measure(run: Run) -> dict[str, Any]:
    """Return what notebooks/04_gecko.ipynb shows of `run`, as JSON data.

    figures: means over episodes in MuJoCo C, as in `compute_figures`; training_speed: the last that
    training measured, in its own physics, m/s; falls: number of episodes with one; gaits: number of
    episodes of each; frames: (FRAMES, 19) qpos of the typical episode, rounded; footfalls: as of
    `find_footfalls` in that episode.
    """
    loaded = load_run(run, SECONDS)
    config = loaded.env.config
    starts = replace(config.reset, joints=max(config.reset.joints, STARTS))
    env = QuadrupedEnv(loaded.env.quadruped, replace(config, reset=starts), "mujoco")
    rollouts = list(simulate_episodes(env, loaded.policy.act, EPISODES, seed=0))
    gaits = [measure_gait(rollout, env.quadruped) for rollout in rollouts]
    figures = [
        compute_figures(gait, rollout, env.quadruped)
        for gait, rollout in zip(gaits, rollouts, strict=True)
    ]
    typical = rollouts[find_typical_episode(figures)]
    return {
        "training_speed": _round(read_metrics(run)[-1]["eval/speed"]),
        "falls": sum(gait.fell for gait in gaits),
        "gaits": dict(Counter(gait.gait for gait in gaits)),
        "figures": {name: _average([row[name] for row in figures]) for name in figures[0]},
        "frames": sample_frames(typical),
        "footfalls": find_footfalls(typical),
    }


def compute_figures(gait: Gait, rollout: Rollout, quadruped: Quadruped) -> dict[str, float]:
    """Return the figures of one episode that differ between a crawl like a gecko's and a gallop.

    speed, m/s; heading, deg, mean |yaw|; height: of the trunk, as a share of the standing height;
    pitching, deg: range of the pitch; sprawl, deg: mean |hip angle|; body_contact: share of the
    time in which anything but a foot is on the floor; flight: share of the time in which nothing
    is; strides, 1/s; stride_length, m; duty_factor; swing_height, m, of the foot that lifts least;
    slip: distance slid as a share of the distance made, of the foot that slips most;
    cost_of_transport; action_rate, 1/s.
    """
    body = find_body_contact(rollout, quadruped)
    yaw = to_roll_pitch_yaw(rollout.qpos[:, 3:7])[:, 2]
    return {
        "speed": gait.speed,
        "heading": float(np.degrees(np.abs(yaw).mean())),
        "height": float(gait.body_height[0] / quadruped.home[2]),
        "pitching": float(np.degrees(gait.pitch_range)),
        "sprawl": float(np.degrees(np.abs(rollout.qpos[1:, 7::3]).mean())),
        "body_contact": float(body.mean()),
        "flight": float((~body & ~rollout.contact.any(axis=1)).mean()),
        "strides": gait.stride_frequency,
        "stride_length": gait.stride_length,
        "duty_factor": float(gait.duty_factor.mean()),
        "swing_height": float(gait.swing_height.min()),
        "slip": float(gait.slip_share.max()),
        "cost_of_transport": gait.cost_of_transport,
        "action_rate": gait.action_rate,
    }


def find_body_contact(rollout: Rollout, quadruped: Quadruped) -> np.ndarray:
    """Return True (T,) for each step at the end of which anything but a foot is on the floor."""
    model = quadruped.make_full_model()
    data = mujoco.MjData(model)
    floor = model.geom("floor").id
    feet = [model.geom(foot).id for foot in quadruped.feet]
    contact = np.zeros(rollout.steps, bool)
    for k, qpos in enumerate(rollout.qpos[1:]):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        pairs = data.contact.geom
        on_floor = (pairs == floor).any(axis=1)
        contact[k] = (on_floor & ~np.isin(pairs, feet).any(axis=1)).any()
    return contact


def sample_frames(rollout: Rollout) -> list[list[float]]:
    """Return `FRAMES` states, (19,) each, over `PICTURED` s in the middle of the episode."""
    middle, half = rollout.steps / 2, PICTURED / rollout.control_dt / 2
    rows = np.linspace(middle - half, middle + half, FRAMES).round().astype(int)
    rows = np.clip(rows, 0, rollout.steps)
    return rollout.qpos[rows].astype(float).round(4).tolist()


def find_footfalls(rollout: Rollout) -> list[list[list[float]]]:
    """Return the contacts of each foot, FR, FL, RR, RL, in the last `SHOWN` s of an episode.

    A contact is [touchdown, liftoff], in s from the beginning of those.
    """
    dt = rollout.control_dt
    contact = remove_chatter(rollout.contact, dt)[-round(SHOWN / dt) :]
    return [(find_contacts(foot) * dt).round(4).tolist() for foot in contact.T]


def _average(values: list[float]) -> float | None:
    """Return the mean of the finite values; None if there are none."""
    finite = [value for value in values if np.isfinite(value)]
    return _round(float(np.mean(finite))) if finite else None


def _round(value: float) -> float:
    """Round to four digits."""
    return float(f"{value:.4g}")
