"""Errors that a user can cause."""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Iterable


class UserError(Exception):
    """Something the user can mend: the message is one line that names it and what is expected."""

    exit_status = 1

    def __str__(self) -> str:
        # A name in a file, or what a library says, may hold more lines.
        return " ".join(super().__str__().splitlines())


class UsageError(UserError):
    """A flag, name or value on the command line that cannot be used."""

    exit_status = 2


def find_line(file: str, error: BaseException) -> int | None:
    """Return the line of `file` that an error came from; None if it is unknown."""
    if isinstance(error, SyntaxError) and error.filename == file:
        return error.lineno
    frames = traceback.extract_tb(error.__traceback__)
    return next((frame.lineno for frame in reversed(frames) if frame.filename == file), None)


def find_similar(name: str, names: Iterable[str], cutoff: float = 0.5) -> str | None:
    """Return the one of `names` that `name` resembles most, by difflib's ratio, or None."""
    return next(iter(difflib.get_close_matches(name, list(names), n=1, cutoff=cutoff)), None)


def suggest(name: str, names: Iterable[str]) -> str:
    """Return "; did you mean 'NAME'?" for the name of `names` that `name` is like, else ""."""
    similar = find_similar(name, names)
    return f"; did you mean {similar!r}?" if similar else ""
