"""Compare what trainings and evaluations compute with a record of it, to the bit.

    .venv/bin/python tools/record.py            # compare with tools/record.json
    .venv/bin/python tools/record.py --write    # write that file anew

The record is of one machine and one set of packages. It holds for changes that move, rename and
simplify code, and is deleted when these are done.
"""

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

ROOT = Path(__file__).parents[1]
RECORD = Path(__file__).with_suffix(".json")
TASKS = ("blog", "drive", "getup", "rough", "run", "walk")
PACKAGED = ("drive", "getup", "rough", "run", "walk")
ENGINES = ("fast", "mjx", "mujoco")
TRAINING = ("--devices", "2", "--envs", "256", "--ppo.eval-envs", "8", "--steps", "15360")
EVALUATION = ("--episodes", "2", "--seconds", "1", "--cell-episodes", "1", "--levels", "1")
# What tells of the commit and the machine instead of the result.
_CHANGING = ("revision", "versions", "run", "policy_sha256", "notes")


def run_program(*arguments: str) -> None:
    """Run a program of the project; raise `SystemExit` with its output if it fails."""
    result = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if result.returncode:
        raise SystemExit(f"{' '.join(arguments)}: {result.stdout}{result.stderr}")


def hash_bytes(*parts: bytes) -> str:
    """Return the first 16 digits of the SHA-256 of `parts`."""
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def hash_arrays(path: Path) -> str:
    """Return the hash of all arrays in a npz file, with their names."""
    with np.load(path) as arrays:
        names = [name for name in sorted(arrays) if not isinstance(arrays[name], bytes)]
        return hash_bytes(*(name.encode() + arrays[name].tobytes() for name in names))


def hash_json(value: dict[str, Any]) -> str:
    """Return the hash of what a JSON file says about a result."""
    figures = {key: figure for key, figure in value.items() if key not in _CHANGING}
    return hash_bytes(json.dumps(figures, sort_keys=True).encode())


def hash_messages(path: Path) -> str:
    """Return the hash of all messages in an MCAP file, with their topics and times."""
    with path.open("rb") as file:
        messages = [
            f"{channel.topic} {message.log_time} ".encode() + message.data
            for _, channel, message in make_reader(file).iter_messages()
        ]
    return hash_bytes(*messages)


def record_training(task: str, folder: Path) -> dict[str, str]:
    """Train `task` for five iterations on two devices; return the hashes of its results."""
    run_program("train.py", task, *TRAINING, "--quiet", "--runs", str(folder), "--name", task)
    return {
        f"train {task} metrics.jsonl": hash_bytes((folder / task / "metrics.jsonl").read_bytes()),
        f"train {task} policy.npz": hash_arrays(folder / task / "policy.npz"),
    }


def record_evaluation(policy: str, engine: str, folder: Path) -> dict[str, str]:
    """Evaluate a packaged policy; return the hashes of its results."""
    out = folder / f"{policy}-{engine}"
    run_program("eval.py", policy, "--engine", engine, *EVALUATION, "-o", str(out))
    name = f"eval {policy} {engine}"
    hashes = {f"{name} metrics.json": hash_json(json.loads((out / "metrics.json").read_text()))}
    if policy == "walk":
        hashes[f"{name} episode_000.mcap"] = hash_messages(out / "episode_000.mcap")
    return hashes


def main() -> None:
    """Compare with the record, or write it."""
    parser = argparse.ArgumentParser(description="Compare results with a record, to the bit.")
    parser.add_argument("--write", action="store_true", help="write the record anew")
    parser.add_argument("--only", default="", help="only items whose name contains this text")
    options = parser.parse_args()
    record = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    jobs = [(record_training, (task,)) for task in TASKS]
    jobs += [(record_evaluation, (name, engine)) for name in PACKAGED for engine in ENGINES]
    different = 0
    with tempfile.TemporaryDirectory() as temporary:
        for function, arguments in jobs:
            kind = "train" if function is record_training else "eval"
            if options.only not in " ".join((kind, *arguments)):
                continue
            for name, value in function(*arguments, Path(temporary)).items():
                same = record.get(name) == value
                different += not same
                print(f"{'equal    ' if same else 'DIFFERENT'} {name}", flush=True)
                record[name] = value
    if options.write:
        RECORD.write_text(json.dumps(record, indent=1, sort_keys=True) + "\n")
    elif different:
        raise SystemExit(f"{different} results differ from {RECORD}")


if __name__ == "__main__":
    main()
