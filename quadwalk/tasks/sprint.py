"""sprint: run along world x as fast as possible, in an ideal world: what no robot could."""

from quadwalk.ground.terrain import FLAT
from quadwalk.physics.motor import MotorConfig
from quadwalk.task import observation, reward, termination
from quadwalk.task.actions import about_home
from quadwalk.task.config import NO_COMMAND, NO_RANDOMISATION, EnvConfig, ResetConfig
from quadwalk.task.terms import ActionMap, Observation, Reward, Termination
from quadwalk.train.settings import PPOConfig, TrainConfig

TASK = TrainConfig(
    task="sprint",
    steps=21_000_000,
    checkpoint_steps=2_000_000,
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
            "heading": Observation(observation.heading, noise=0.05),
            "offset": Observation(observation.offset, {"reach": 1.0}, noise=0.05),
            "position": Observation(observation.joint_positions, noise=0.01),
            "speed": Observation(observation.joint_velocities, noise=1.5),
            "last_action": Observation(observation.last_action),
        },
        critic={},
        reward={
            "forward": Reward(reward.forward, {"max_speed": 7.0}, scale=1.0),
            "fall": Reward(reward.fall, scale=-10.0),
            "yaw": Reward(reward.yaw_error, scale=-0.6),
            "energy": Reward(reward.energy, scale=-0.02),
            "alive": Reward(reward.alive, scale=0.5),
            "lateral": Reward(reward.lateral, scale=-0.3),
            "offset": Reward(reward.offset, scale=-0.3),
            "vertical": Reward(reward.vertical, scale=-0.3),
            "tilt": Reward(reward.tilt, scale=-0.5),
            "roll_pitch_rate": Reward(reward.roll_pitch_rate, scale=-0.1),
            "action_rate": Reward(reward.action_rate, scale=-0.1),
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
        command=NO_COMMAND,
        randomisation=NO_RANDOMISATION,
        ground=FLAT,
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
