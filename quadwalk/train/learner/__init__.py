"""The learner: networks, PPO, and an iteration of it compiled."""
