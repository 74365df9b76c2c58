"""`python -m quadwalk.view.alongside`: `quadwalk view` for as long as standard input is open."""

from quadwalk.cli.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.view.alongside")

import os
import sys
import threading

from quadwalk.view.__main__ import main as view


def main() -> None:
    """Show the page; the end of the process that holds standard input open ends it."""

    def end() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    threading.Thread(target=end, daemon=True).start()
    view()
