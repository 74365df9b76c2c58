"""Errors that a user can cause, and how the command lines show them."""

import sys
from collections.abc import Callable


class UserError(Exception):
    """Something the user can mend: the message is one line that names it and what is expected."""

    exit_status = 1

    def __str__(self) -> str:
        # A name in a file, or what a library says, may hold more lines.
        return " ".join(super().__str__().splitlines())


class UsageError(UserError):
    """A flag, name or value on the command line that cannot be used."""

    exit_status = 2


def run_command(main: Callable[[], None]) -> None:
    """Run a command line; turn a `UserError` into one line on stderr and its exit status."""
    try:
        main()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(error.exit_status)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(1)
