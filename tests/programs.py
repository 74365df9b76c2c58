"""Programs as a user starts them."""

import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


def python(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run this Python with `arguments` to its end; return its status and output.

    By default it runs in the checkout. `options` are those of `subprocess.run`.
    """
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, **{"cwd": ROOT, **options})
