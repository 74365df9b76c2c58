"""What a study has found, in a file beside it: one result of each variant and seed."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from quadwalk.errors import UserError
from quadwalk.files import open_atomic


class Results:
    """Those in the file at `path`, if there is one, and those that are added.

    A result is plain values, of which "variant" is one of `variants` and "seed" an int. Raises
    `UserError` where the file holds anything else.
    """

    def __init__(self, path: Path, variants: Iterable[str]) -> None:
        self.path = path
        self._variants = list(variants)
        try:
            found = json.loads(path.read_text()) if path.exists() else []
            self._by_key = {self._key(result): result for result in found}
        except (ValueError, KeyError, TypeError) as error:
            named = ", ".join(self._variants)
            raise UserError(
                f"{path} does not hold a study's results of variants {named}"
            ) from error

    def _key(self, result: dict[str, Any]) -> tuple[int, int]:
        """Where it belongs among the others."""
        return self._variants.index(result["variant"]), result["seed"]

    def add(self, result: dict[str, Any]) -> None:
        """Write it at once, in place of an earlier one of its variant and seed."""
        self._by_key[self._key(result)] = result
        # One line for each, so that a change shows which.
        lines = ",\n".join(json.dumps(self._by_key[key]) for key in sorted(self._by_key))
        with open_atomic(self.path) as file:
            file.write(f"[\n{lines}\n]\n".encode())
