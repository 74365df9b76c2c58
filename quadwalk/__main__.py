"""The console command `quadwalk`: `quadwalk train`, `quadwalk eval` and the others."""

import importlib
import sys

import quadwalk
from quadwalk.cli.process import run_command
from quadwalk.errors import UsageError, meant

_COMMANDS = {
    "train": ("quadwalk.learn.__main__", "train a quadruped in a task"),
    "eval": ("quadwalk.eval", "evaluate a trained policy"),
    "view": ("quadwalk.view.__main__", "drive a trained policy live"),
    "demo": ("quadwalk.view.__main__", "drive a policy that comes trained, in a page"),
    "export": ("quadwalk.export.__main__", "write a policy as ONNX, to be used elsewhere"),
    "compare": ("quadwalk.experiments.compare", "train variants over seeds, and compare them"),
    "tune": ("quadwalk.experiments.tune", "search the settings that make a policy best"),
    "identify": ("quadwalk.identify.__main__", "fit a robot's joints to a log of them"),
    "runs": ("quadwalk.runs.__main__", "list, show and remove training runs"),
    "tasks": ("quadwalk.tasks.__main__", "list the tasks"),
    "robot": ("quadwalk.robot.__main__", "convert a URDF to MJCF, or draw it"),
    "terrain": ("quadwalk.terrain.__main__", "draw every kind of terrain"),
    "doctor": ("quadwalk.cli.doctor", "print versions, devices, cores, and what is off here"),
}
_DEMO = ("drive", "--browser")


def command() -> None:
    """Run the command that the first argument names with the others."""
    given, *others = sys.argv[1:] or ["--help"]
    if given in ("-h", "--help"):
        print("usage: quadwalk COMMAND [OPTIONS]; quadwalk COMMAND --help lists the options\n")
        for name, (_, what) in _COMMANDS.items():
            print(f"  {name:<9}{what}")
        return
    if given == "--version":
        print(f"quadwalk {quadwalk.__version__}")
        return
    if given == "--print-completion":
        from quadwalk.cli.completion import completion_script  # it imports JAX

        modules = {name: module for name, (module, _) in _COMMANDS.items()}
        print(completion_script(others[0] if others else "", modules), end="")
        return
    if given not in _COMMANDS:
        known = ", ".join(_COMMANDS)
        raise UsageError(f"no command {given!r}; expected one of: {known}{meant(given, _COMMANDS)}")
    if given == "demo":
        others = [*_DEMO, *others]
    importlib.import_module(_COMMANDS[given][0]).main(others, f"quadwalk {given}")


def main() -> None:
    """The entry point of the installed package."""
    run_command(command)


if __name__ == "__main__":
    main()
