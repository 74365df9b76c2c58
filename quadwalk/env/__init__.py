"""The environment: reset, step, observation, reward and termination as pure JAX functions."""
