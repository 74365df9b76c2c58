"""The console command `quadwalk`: `quadwalk train`, `quadwalk eval` and the others."""

import importlib
import sys

from quadwalk.errors import UsageError
from quadwalk.process import run_command

_COMMANDS = {
    "train": ("quadwalk.train.__main__", "teach a quadruped a task"),
    "eval": ("quadwalk.eval", "judge a trained policy"),
    "export": ("quadwalk.export.__main__", "write a policy as ONNX, to be used elsewhere"),
    "compare": ("quadwalk.variants.__main__", "train variants over seeds, and judge them"),
    "view": ("quadwalk.view.__main__", "drive a trained policy live"),
    "robot": ("quadwalk.robot.__main__", "convert a URDF to MJCF, or draw it"),
    "ground": ("quadwalk.ground.__main__", "draw every kind of ground"),
    "doctor": ("quadwalk.doctor", "print versions, devices, cores, and what is off here"),
}


def command() -> None:
    """Run the command that the first argument names with the others."""
    given = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if given in ("-h", "--help"):
        print("usage: quadwalk COMMAND [OPTIONS]; quadwalk COMMAND --help lists the options\n")
        for name, (_, what) in _COMMANDS.items():
            print(f"  {name:<7} {what}")
        return
    if given not in _COMMANDS:
        raise UsageError(f"no command {given!r}; expected one of: {', '.join(_COMMANDS)}")
    importlib.import_module(_COMMANDS[given][0]).main(sys.argv[2:], f"quadwalk {given}")


def main() -> None:
    """The entry point of the installed package."""
    run_command(command)


if __name__ == "__main__":
    main()
