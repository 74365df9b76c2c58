"""Teach a quadruped to run: `python train.py --help`."""

from quadwalk.command.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.train.__main__")
