"""The command line, generated from configuration dataclasses by tyro."""

import argparse
import contextlib
import difflib
import io
import os
import re
import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from quadwalk.errors import UsageError, meant

if TYPE_CHECKING:
    from rich.console import Console

T = TypeVar("T")


def parse(
    cls: type[T],
    args: Sequence[str],
    prog: str,
    default: T | None = None,
    description: str | None = None,
    lister: str = "--help",
) -> T:
    """Parse `args` into `cls`, every field a flag; a bad one is a `UsageError` in one line.

    `description` is for `--help`, in place of the docstring of `cls`; `lister` lists all flags.
    """
    import tyro  # not at the top: commands that use `ArgumentParser` begin without it

    # Not public yet, so pyproject.toml names an exact version of tyro.
    errors = tyro._errors

    unknown: list[str] = []
    see = f"({prog} {lister} lists all)"

    def refuse(event: Any) -> None:
        if isinstance(event, errors.UnrecognizedArgs):
            unknown.extend(event.tokens)  # and tyro goes on to say which flags are like it
            return
        argument = getattr(event, "argument", None)
        if argument is None:
            problem = " ".join(str(getattr(event, "message", type(event).__name__)).split())
            raise UsageError(f"{problem} {see}")
        flag, expected = argument.lowered.name_or_flags[-1], argument.lowered.metavar
        if expected.startswith("{None}|"):
            expected = f"{expected.removeprefix('{None}|')} or None"
        if (value := value_of(args, flag) or "").startswith("-"):
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
        hint = _similar_flag(names[0], printed.getvalue())
        raise UsageError(f"unknown option {', '.join(names)}{hint} {see}") from None


def _similar_flag(name: str, printed: str) -> str:
    """Return `; did you mean --FLAG?` with the closest of the flags that tyro has printed.

    tyro sorts flags that contain `name` by the alphabet, `--checkpoint-steps` before `--steps`.
    """
    similar = re.findall(r"--[\w.-]+", printed.partition("Perhaps you meant:")[2])
    if not similar:
        return ""
    closest = difflib.get_close_matches(name, similar, n=1, cutoff=0.0)[0]
    return f"; did you mean {closest}?"


class ArgumentParser(argparse.ArgumentParser):
    """One whose errors are a `UsageError` in one line, as those of `parse`."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        for arg in sys.argv[1:] if args is None else args:
            if arg.endswith("=--"):  # argparse would make no value of it
                self.error(f"{arg}: expected a value")
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        unknown = re.match(r"unrecognized arguments: (--[\w-]+)", message)
        hint = meant(unknown[1], self._option_string_actions) if unknown else ""
        raise UsageError(f"{message}{hint} ({self.prog} --help lists all)")


def message_console() -> "Console":
    """For what a command says beside its results: to standard error, as it is, in whole lines."""
    from rich.console import Console  # what parses alone does not wait for it

    return Console(stderr=True, highlight=False, soft_wrap=True, markup=False, emoji=False)


def split_words(text: str) -> list[str]:
    """Return the words of `text` as a shell reads them; `UsageError` for a quote without its end.

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


def value_of(args: Sequence[str], flag: str) -> str | None:
    """The last value of `flag` among `args`, None if it is not there."""
    return taken(args, flag)[0]


def taken(args: Sequence[str], flag: str) -> tuple[str | None, list[str]]:
    """The last value of `flag`, or None, and `args` without it."""
    value, left, rest = None, list[str](), iter(args)
    for arg in rest:
        if arg == flag:
            value = next(rest, "")
        elif arg.startswith(f"{flag}="):
            value = arg.partition("=")[2]
        else:
            left.append(arg)
    return value, left
