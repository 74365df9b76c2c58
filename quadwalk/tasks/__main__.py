"""`quadwalk tasks`: the tasks that come with the package."""

from quadwalk.cli.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.tasks.__main__")

from collections.abc import Sequence

from quadwalk.cli.arguments import ArgumentParser
from quadwalk.task_files import task_table


def main(args: Sequence[str] | None = None, prog: str = "quadwalk tasks") -> None:
    """Print a line for each task."""
    ArgumentParser(prog=prog, description="List the tasks.").parse_args(args)
    print(task_table())
