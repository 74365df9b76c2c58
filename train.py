"""Teach a quadruped to run: `python train.py --help`."""

from quadwalk.cli.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.learn.__main__")
