"""`quadwalk eval`, which is also `eval.py`."""

from quadwalk.cli.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.eval")
