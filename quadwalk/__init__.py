"""quadwalk: teach a quadruped to run, on an ordinary CPU, in minutes."""

__version__ = "0.1.0"
