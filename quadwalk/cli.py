"""The command line, generated from configuration dataclasses by tyro."""

import contextlib
import io
import re
from collections.abc import Sequence
from typing import Any, TypeVar

from quadwalk.errors import UsageError

T = TypeVar("T")


def parse(
    cls: type[T],
    args: Sequence[str],
    prog: str,
    default: T | None = None,
    description: str | None = None,
) -> T:
    """Parse `args` into `cls`, every field a flag; a bad one is a `UsageError` in one line.

    `description` is for `--help`, in place of the docstring of `cls`.
    """
    import tyro

    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            settings: Any = tyro.cli(
                cls,
                prog=prog,
                description=description,
                default=default,
                args=list(args),
                # A task's functions are no flags.
                config=(tyro.conf.SuppressFixed,),
            )
            return settings
    except SystemExit as stop:
        if not stop.code:  # --help
            raise
        raise UsageError(f"{_one_line(errors.getvalue())} ({prog} --help lists all)") from None


def value_of(args: Sequence[str], flag: str) -> str | None:
    """The value of `flag` among `args`, None if it is not there."""
    for arg, following in zip(args, [*args[1:], ""], strict=False):
        if arg == flag:
            return following
        if arg.startswith(f"{flag}="):
            return arg.partition("=")[2]
    return None


def _one_line(framed: str) -> str:
    """The message of tyro's framed error, and the flag it suggests."""
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).strip("│ ") for line in framed.splitlines()]
    lines = [line for line in lines if not line.startswith(("╭", "╰"))]
    sections = [" ".join(s.split()) for s in re.split(r"\n─+\n", "\n".join(lines))]
    suggestion = re.search(r"Perhaps you meant:\s*(--\S+)", " ".join(sections[1:]))
    return sections[0] + (f"; did you mean {suggestion[1]}?" if suggestion else "")
