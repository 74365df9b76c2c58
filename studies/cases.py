"""What the studies share: trainings of variants over seeds, and the file of their results."""

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from quadwalk.errors import UserError
from quadwalk.experiments.job import Job
from quadwalk.experiments.options import PlaceConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import collect_values, run_jobs
from quadwalk.files import open_atomic

Case = tuple[str, int]  # a variant and a seed


def run_cases(jobs: Mapping[Case, Job], place: PlaceConfig) -> Iterator[tuple[Case, Any]]:
    """Train and evaluate each case; yield it with what its job returns, as soon as each ends."""
    cases = {job.name: case for case, job in jobs.items()}
    outcomes = run_jobs(list(jobs.values()), make_place(place), len(jobs))
    for job, value in collect_values(outcomes):
        yield cases[job.name], value


class Results:
    """The results in the file at `path`, if there is one, and those that are added.

    A result is plain values, of which "variant" is one of `variants` and "seed" an int. Raises
    `UserError` where the file holds anything else.
    """

    def __init__(self, path: Path, variants: Iterable[str]) -> None:
        self.path = path
        self._variants = list(variants)
        try:
            results = json.loads(path.read_text()) if path.exists() else []
            self._by_key = {self._get_key(result): result for result in results}
        except (ValueError, KeyError, TypeError) as error:
            variants = ", ".join(self._variants)
            raise UserError(
                f"{path} does not hold a study's results of variants {variants}"
            ) from error

    def _get_key(self, result: dict[str, Any]) -> tuple[int, int]:
        """Return the place of a result in the file: by its variant, then by its seed."""
        return self._variants.index(result["variant"]), result["seed"]

    def add(self, result: dict[str, Any]) -> None:
        """Add a result and write the file; it replaces one of the same variant and seed."""
        self._by_key[self._get_key(result)] = result
        # One line for each, so that a change shows which.
        lines = ",\n".join(json.dumps(self._by_key[key]) for key in sorted(self._by_key))
        with open_atomic(self.path) as file:
            file.write(f"[\n{lines}\n]\n".encode())
