"""Teach a quadruped to run: `python train.py --help`."""

from quadwalk.errors import run_command
from quadwalk.train.__main__ import main

if __name__ == "__main__":
    run_command(main)
