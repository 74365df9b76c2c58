"""Judge a trained policy: `python eval.py --help`."""

from quadwalk.errors import run_command
from quadwalk.evaluate.__main__ import main

if __name__ == "__main__":
    run_command(main)
