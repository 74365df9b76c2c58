"""Evaluate a trained policy: `python eval.py --help`."""

from quadwalk.cli.main import main

if __name__ == "__main__":
    main("eval")
