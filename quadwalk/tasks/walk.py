"""walk: follow a velocity command, at a trot, in an ideal world."""

from quadwalk.physics.motor import MotorConfig
from quadwalk.task import observation, reward, termination
from quadwalk.task.actions import about_home
from quadwalk.task.config import NO_RANDOMISATION, CommandConfig, EnvConfig, ResetConfig
from quadwalk.task.terms import ActionMap, Observation, Reward, Termination
from quadwalk.train.settings import PPOConfig, TrainConfig

TASK = TrainConfig(
    task="walk",
    steps=6_000_000,
    checkpoint_steps=1_000_000,
    env=EnvConfig(
        engine="fast",
        gravity=9.81,
        physics_dt=0.004,
        substeps=5,
        solver_iterations=2,
        line_search_iterations=3,
        contacts="feet",
        episode_seconds=20.0,
        motor=MotorConfig(kp=None, kd=None, effort=None, speed_limit=True, joint_friction=True),
        action=ActionMap(about_home, {"hip": 0.3, "thigh": 0.9, "calf": 0.9}),
        observation={
            "velocity": Observation(observation.velocity, noise=0.1),
            "angular_velocity": Observation(observation.angular_velocity, noise=0.2),
            "gravity": Observation(observation.gravity, noise=0.05),
            "command": Observation(observation.command, labels=("forward", "lateral", "yaw_rate")),
            "position": Observation(observation.joint_positions, noise=0.01),
            "speed": Observation(observation.joint_velocities, noise=1.5),
            "last_action": Observation(observation.last_action),
        },
        critic={},
        reward={
            "fall": Reward(reward.fall, scale=-10.0),
            "energy": Reward(reward.energy, scale=-0.3),
            "vertical": Reward(reward.vertical, scale=-0.5),
            "tilt": Reward(reward.tilt, scale=-0.5),
            "roll_pitch_rate": Reward(reward.roll_pitch_rate, scale=-0.05),
            "action_rate": Reward(reward.action_rate, scale=-0.3),
            "follow": Reward(reward.follow, {"width": 0.5}, scale=1.0),
            "follow_yaw_rate": Reward(reward.follow_yaw_rate, {"width": 0.5}, scale=0.5),
            "drag": Reward(reward.drag, {"height": 0.06}, scale=-0.3),
            "trot": Reward(reward.trot, scale=0.5),
        },
        termination={
            "tipped": Termination(termination.tipped, {"angle": 1.0}),
            "low": Termination(termination.low, {"share": 0.45}),
            "touched": Termination(termination.touched, {"clearance": 0.0}),
        },
        reset=ResetConfig(
            pose=None,
            height=None,
            yaw=0.3,
            tilt=0.1,
            offset=0.3,
            joints=0.2,
            velocity=0.5,
            joint_velocity=0.5,
            forward=0.0,
        ),
        command=CommandConfig(
            forward=(-0.5, 1.5),
            lateral=(-0.5, 0.5),
            yaw_rate=(-1.0, 1.0),
            standing=0.1,
            seconds=5.0,
        ),
        randomisation=NO_RANDOMISATION,
    ),
    ppo=PPOConfig(
        eval_envs=64,
        unroll=12,
        minibatches=4,
        epochs=2,
        learning_rate=1e-3,
        desired_kl=0.03,
        final_kl=0.01,
        min_learning_rate=1e-5,
        max_learning_rate=1e-2,
        discount=0.97,
        gae_lambda=0.95,
        clip=0.2,
        noise=0.35,
        entropy=0.01,
        final_entropy=0.001,
        value=1.0,
        max_grad_norm=1.0,
        reward_scale=0.1,
        hidden=(128, 128, 128),
        activation="swish",
    ),
)
