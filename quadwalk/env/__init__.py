"""The environment: reset, step, observation, reward and termination as pure JAX functions."""

import contextlib
import io

# MJX prints two lines on standard output about an optional back end that is not installed.
with contextlib.redirect_stdout(io.StringIO()):
    import mujoco.mjx  # noqa: F401
