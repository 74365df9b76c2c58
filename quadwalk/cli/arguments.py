"""The command line, made from configuration dataclasses by tyro."""

import contextlib
import io
import os
import re
import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from quadwalk.errors import UsageError, suggest

if TYPE_CHECKING:
    from rich.console import Console

T = TypeVar("T")

# Among the arguments: `parse` raises `OptionsFoundError`, for a shell's completion.
FIND_OPTIONS = "--find-options"


class OptionsFoundError(Exception):
    """The dataclass of a command's options and its defaults, where `FIND_OPTIONS` asked for it."""

    def __init__(self, cls: type[Any], default: Any) -> None:
        self.cls = cls
        self.default = default


def parse(
    cls: type[T],
    args: Sequence[str],
    prog: str,
    default: T | None = None,
    description: str | None = None,
    help_flag: str = "--help",
) -> T:
    """Parse `args` into `cls`, a dataclass whose fields are the flags.

    Raises a `UsageError` in one line for a bad flag. `prog` is the command's name in messages,
    `description` the text of the help, by default the docstring of `cls`. `help_flag` is the flag
    of the help that messages mention.
    """
    if FIND_OPTIONS in args:
        raise OptionsFoundError(cls, default)
    import tyro  # not at the top: what does not parse begins without it

    # Not public yet, so pyproject.toml names an exact version of tyro.
    errors = tyro._errors

    unknown: list[str] = []
    see = f"({prog} {help_flag} lists all)"

    def refuse(event: Any) -> None:
        if isinstance(event, errors.UnrecognizedArgs):
            unknown.extend(event.tokens)  # and tyro goes on to print which flags are like it
            return
        if isinstance(event, errors.MissingArgs):
            names = ", ".join(missing.arg.display_name() for missing in event.missing_arguments)
            raise UsageError(f"missing: {names} {see}")
        argument = getattr(event, "argument", None)
        if argument is None:
            problem = " ".join(str(getattr(event, "message", type(event).__name__)).split())
            raise UsageError(f"{problem} {see}")
        flag, expected = argument.lowered.name_or_flags[-1], argument.lowered.metavar
        if expected.startswith("{None}|"):
            expected = f"{expected.removeprefix('{None}|')} or None"
        if (value := find_value(args, flag) or "").startswith("-"):
            expected += f", and for a value that begins with a dash {flag}={value}"
        raise UsageError(f"bad value for {flag}; expected {expected} {see}")

    printed = io.StringIO()
    try:
        with errors.on_parse_error(refuse), contextlib.redirect_stderr(printed):
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
    except SystemExit:
        if not unknown:  # --help
            raise
        names = [token for token in unknown if token.startswith("-")] or unknown
        similar = re.findall(r"--[\w.-]+", printed.getvalue().partition("Perhaps you meant:")[2])
        hint = suggest(names[0].partition("=")[0], similar)
        raise UsageError(f"unknown option {', '.join(names)}{hint} {see}") from None


def make_console() -> "Console":
    """Return a console on standard error, for what a command prints beside its results.

    Text is printed as it is, without markup, and no line is broken.
    """
    from rich.console import Console  # what parses alone does not wait for it

    return Console(stderr=True, highlight=False, soft_wrap=True, markup=False, emoji=False)


def split_words(text: str) -> list[str]:
    """Return the words of `text` as a shell splits them; `UsageError` for a quote without its end.

    On Windows a backslash is a part of a path, as in its own shells.
    """
    lexer = shlex.shlex(text, posix=True)
    lexer.whitespace_split = True
    lexer.commenters = ""
    if os.name == "nt":
        lexer.escape = ""
    try:
        return list(lexer)
    except ValueError:
        raise UsageError(f"{text!r} has a quote or a backslash that is not closed") from None


def find_value(args: Sequence[str], flag: str) -> str | None:
    """Return the last value of `flag` in `args`, as "FLAG VALUE" or "FLAG=VALUE", or None."""
    return take_value(args, flag)[0]


def take_value(args: Sequence[str], flag: str) -> tuple[str | None, list[str]]:
    """Return the last value of `flag` in `args`, or None, and `args` without flag and values."""
    value, others, words = None, list[str](), iter(args)
    for word in words:
        if word == flag:
            value = next(words, "")
        elif word.startswith(f"{flag}="):
            value = word.partition("=")[2]
        else:
            others.append(word)
    return value, others
