"""Evaluate a trained policy: `python eval.py --help`."""

from quadwalk.cli.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.eval")
