"""Completion in a shell: the commands, and the flags that the help of each lists."""

import contextlib
import io
import os
import re
from collections.abc import Callable, Iterable, Mapping
from unittest import mock

from quadwalk.errors import UsageError
from quadwalk.task_files import task_names

SHELLS = ("bash", "zsh")
_FLAG = re.compile(r"(?<![\w.-])(--?[a-z][\w.-]*)(?: \{(\w+(?:,\w+)+)\})?")
_ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"
_SCRIPT = """_quadwalk() {{
  local cur="${{COMP_WORDS[COMP_CWORD]}}" prev="${{COMP_WORDS[COMP_CWORD-1]}}" words=""
  case "$COMP_CWORD ${{COMP_WORDS[1]}} $prev" in
    1\\ *) words="{commands}" ;;
    2\\ train\\ *) words="{tasks}" ;;
    2\\ runs\\ *) words="list show remove" ;;
{values}
    *\\ --resume|*\\ --init|*\\ --getup|*\\ eval\\ [!-]*|*\\ view\\ [!-]*|\
*\\ export\\ [!-]*|*\\ runs\\ [!-]*)
      words="latest $(ls runs 2>/dev/null)" ;;
  esac
  case "$cur" in -*) case "${{COMP_WORDS[1]}}" in
{flags}
  esac ;; esac
  COMPREPLY=($(compgen -W "$words" -- "$cur"))
}}
complete -o default -F _quadwalk quadwalk
"""


def completion_script(
    shell: str, commands: Iterable[str], call: Callable[[str, list[str], str], None]
) -> str:
    """The script that `shell` sources to complete `commands`, whose functions `call` calls.

    `UsageError` for a shell that is not one of `SHELLS`.
    """
    if shell not in SHELLS:
        raise UsageError(f"--print-completion {shell}: expected {' or '.join(SHELLS)}")
    flags: dict[str, str] = {}
    values: dict[str, str] = {}
    for name in commands:
        found = _flags(name, call)
        flags[name] = " ".join(found)
        values |= {f"*\\ {name}\\ {flag}": words for flag, words in found.items() if words}
    text = _SCRIPT.format(
        commands=" ".join(commands),
        tasks=" ".join(task_names()),
        values=_cases(values),
        flags=_cases(flags),
    )
    return _ZSH + text if shell == "zsh" else text


def _flags(name: str, call: Callable[[str, list[str], str], None]) -> dict[str, str]:
    """The flags in the help of a command, each with the words that it takes, or ""."""
    listing = "--help-all" if name == "train" else "--help"
    printed = io.StringIO()
    with (
        mock.patch.dict(os.environ, COLUMNS="1000"),  # no flag is broken over two lines
        contextlib.redirect_stdout(printed),
        contextlib.suppress(SystemExit),
    ):
        call(name, [listing], f"quadwalk {name}")
    found: dict[str, str] = {}
    for flag, words in _FLAG.findall(printed.getvalue()):
        found[flag] = found.get(flag) or words.replace(",", " ")
    return found


def _cases(words: Mapping[str, str]) -> str:
    return "\n".join(f'    {pattern}) words="{found}" ;;' for pattern, found in words.items())
