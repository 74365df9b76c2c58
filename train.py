"""Teach a quadruped to run: `python train.py --help`."""

from quadwalk.cli.main import main

if __name__ == "__main__":
    main("train")
