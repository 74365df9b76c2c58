"""`quadwalk view` for as long as standard input is open."""

import os
import sys
import threading
from collections.abc import Sequence

from quadwalk.view import show


def main(args: Sequence[str], prog: str) -> None:
    """Show the page; the end of the process that holds standard input open ends it."""

    def end() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    threading.Thread(target=end, daemon=True).start()
    show.main(args, prog)
