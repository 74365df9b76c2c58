"""obstacles: run along world x, as fast as is safe, over blocks, logs and ditches."""

from quadwalk.ground.terrain import GroundConfig
from quadwalk.physics.motor import MotorConfig
from quadwalk.task import observation, reward, termination
from quadwalk.task.actions import about_home
from quadwalk.task.config import NO_COMMAND, EnvConfig, RandomisationConfig, ResetConfig
from quadwalk.task.terms import ActionMap, Observation, Reward, Termination
from quadwalk.train.settings import PPOConfig, TrainConfig

# m; at 3 m/s what is 1.5 m ahead comes in half a second.
SCAN = {"first": -0.5, "last": 1.5, "width": 0.5, "spacing": 0.125, "reach": 0.5}

TASK = TrainConfig(
    task="obstacles",
    steps=32_000_000,
    checkpoint_steps=2_000_000,
    env=EnvConfig(
        engine="fast",
        gravity=9.81,
        physics_dt=0.004,
        substeps=5,
        solver_iterations=2,
        line_search_iterations=3,
        contacts="knees",  # the trunk's touch is the end
        episode_seconds=10.0,
        motor=MotorConfig(kp=None, kd=None, effort=None, speed_limit=True, joint_friction=True),
        action=ActionMap(about_home, {"hip": 0.3, "thigh": 0.9, "calf": 0.9}),
        observation={
            "heading": Observation(observation.heading, noise=0.05),
            "angular_velocity": Observation(observation.angular_velocity, noise=0.2, history=4),
            "gravity": Observation(observation.gravity, noise=0.05, history=4),
            "position": Observation(observation.joint_positions, noise=0.01, history=4),
            "speed": Observation(observation.joint_velocities, noise=1.5, history=4),
            "last_action": Observation(observation.last_action, history=4),
            "height_scan": Observation(observation.scan_ahead, SCAN, noise=0.03),
        },
        critic={
            "velocity": Observation(observation.velocity),
            "angular_velocity": Observation(observation.angular_velocity),
            "gravity": Observation(observation.gravity),
            "height": Observation(observation.height),
            "heading": Observation(observation.heading),
            "position": Observation(observation.joint_positions),
            "speed": Observation(observation.joint_velocities),
            "contacts": Observation(observation.contacts),
            "conditions": Observation(observation.conditions),
        },
        reward={
            # Where faster pays, one in eight falls over blocks of 10 cm, whatever a fall costs.
            "forward": Reward(reward.forward, {"max_speed": 2.75}, scale=1.0),
            "fall": Reward(reward.fall, scale=-30.0),
            "yaw": Reward(reward.yaw_error, scale=-0.6),
            "energy": Reward(reward.energy, scale=-0.02),
            "alive": Reward(reward.alive, scale=0.5),
            "lateral": Reward(reward.lateral, scale=-0.3),
            "vertical": Reward(reward.vertical, scale=-0.1),
            "tilt": Reward(reward.tilt, scale=-0.2),
            "roll_pitch_rate": Reward(reward.roll_pitch_rate, scale=-0.1),
            "action_rate": Reward(reward.action_rate, scale=-0.1),
            # Else it goes on its knees: they may touch. Where it stands, shins are 2 cm up.
            "kneel": Reward(reward.kneel, {"height": 0.015}, scale=-1.0),
        },
        termination={
            "tipped": Termination(termination.tipped, {"angle": 1.0}),
            "low": Termination(termination.low, {"share": 0.35}),
            # Knees and shins may touch: at the edge of a block they are bound to.
            "trunk_touched": Termination(termination.trunk_touched, {"clearance": 0.0}),
        },
        reset=ResetConfig(
            pose=None,
            height=None,
            yaw=0.3,
            tilt=0.1,
            offset=0.0,
            joints=0.2,
            velocity=0.5,
            joint_velocity=0.5,
            forward=0.0,
        ),
        command=NO_COMMAND,
        randomisation=RandomisationConfig(
            enabled=True,
            friction=(0.3, 1.25),
            trunk_mass=(-0.1, 0.25),
            trunk_centre=(-0.08, 0.08),
            link_mass=(0.9, 1.1),
            strength=(0.8, 1.1),
            kp=(0.8, 1.2),
            kd=(0.8, 1.2),
            joint_friction=(0.5, 1.5),
            damping=(0.5, 1.5),
            armature=(0.8, 1.2),
            encoder=(-0.02, 0.02),
            imu_tilt=(-0.02, 0.02),
            latency=(0.0, 0.02),
            sensor_latency=(0.0, 0.01),
            noise=(0.0, 1.0),
            push=(0.0, 0.5),
        ),
        ground=GroundConfig(
            kinds=("course",) * 6,  # each row another
            levels=6,
            difficulty=(0.0, 1.0),
            tile=(20.0, 5.0),
            border=1.0,
            cell=0.05,
            seed=0,
            step=None,
            tread=None,
            block=None,
            roughness=None,
            file=None,
            white=1.0,
            curriculum=True,
        ),
        blind=False,
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
        discount=0.98,
        gae_lambda=0.95,
        clip=0.2,
        noise=0.35,
        entropy=0.003,
        final_entropy=0.001,
        value=1.0,
        max_grad_norm=1.0,
        reward_scale=0.1,
        hidden=(256, 192, 128),
        activation="swish",
        settle=0.8,
    ),
)
