"""Commands that the pages show: each is read by its own parser, and names what is there."""

import contextlib
import importlib.util
import re
import shlex
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import tyro

from quadwalk.cli import main
from quadwalk.errors import UsageError
from quadwalk.experiments.commands import split_variants
from quadwalk.files import format_json
from quadwalk.learn.flags import parse_config
from quadwalk.runs.directory import create_run, get_versions
from quadwalk.settings.serialize import to_dict
from quadwalk.task_files import load_task

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md")])
BLOCK = re.compile(r"```sh\n(.*?)```", re.DOTALL)
OWN_TASK = re.compile(r"```python\n(# my_task.py\n.*?)```", re.DOTALL)
INLINE = re.compile(r"`((?:python|quadwalk|make) [^`]+)`")
FLAGS = re.compile(r"`(--[^`\n]+ [^`\n]+)`")
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
PLACES = {
    ".venv/bin/python": "python", "TASK": "walk", "COMMAND": "train", "VARIANT": "", "N": "1",
    "K": "0", "HOST:PORT": "a:1", "NAME": "fast",
}  # fmt: skip
# Programs of others, and one of the check.
OTHERS = (
    ".ci/quickstart", "git", "ray", "rerun", "pip", ".venv/bin/pip", ".venv/bin/pre-commit",
)  # fmt: skip


class ParsedError(Exception):
    """The command line was read, and nothing is to be done."""


@pytest.fixture
def parse(monkeypatch, tmp_path) -> Callable[..., None]:
    """Return a function that calls `quadwalk` with words, up to where they are parsed."""

    def stopping(real):
        def parse(*args, **kwargs):
            real(*args, **kwargs)
            raise ParsedError

        return parse

    monkeypatch.setattr(tyro, "cli", stopping(tyro.cli))
    monkeypatch.chdir(tmp_path)
    (task,) = OWN_TASK.findall((ROOT / "docs/extend.md").read_text())
    (tmp_path / "my_task.py").write_text(task)
    config = format_json({"config": to_dict(load_task("run")), "versions": get_versions()})
    for name in ("fast", "bounce"):  # that pages resume
        create_run("runs", name, files={"config.json": config, "desk.jsonl": b""})

    def call(*words: str) -> None:
        with contextlib.suppress(ParsedError, SystemExit):  # the latter of --help
            main.call_command(words)

    return call


def list_commands(page: Path) -> list[list[str]]:
    """Return the words of each command that a page shows, in blocks and in its text."""
    text = page.read_text()
    lines = [line for block in BLOCK.findall(text) for line in block.splitlines()]
    lines += [re.sub(r"[\[\]]| \.\.\.", "", line) for line in INLINE.findall(BLOCK.sub("", text))]
    commands: list[list[str]] = []
    for line in lines:
        commands.append([])
        for word in shlex.split(line, comments=True):
            if word == "&&":
                commands.append([])
            else:
                commands[-1].append(PLACES.get(word, word))
    return [words for words in commands if words]


def arguments(words: list[str]) -> list[str] | None:
    """Return what a command hands to `quadwalk`; None for another program."""
    match words:
        case ["quadwalk", *rest] | ["python", "-m", "quadwalk", *rest]:
            return rest
        case ["python", ("train.py" | "eval.py") as script, *rest]:
            return [script.removesuffix(".py"), *rest]
        case ["uv", "run", ("train.py" | "eval.py") as script, *rest]:
            return arguments(["python", script, *rest])
        case ["uv", "run", *rest]:
            return arguments(rest)
    return None


def assert_extras_and_files(word: str) -> None:
    extras = re.findall(r"^(?:\.|quadwalk)\[([\w,]+)\]$", word)
    assert {name for each in extras for name in each.split(",")} <= EXTRAS.keys()
    assert not word.endswith((".py", ".lock")) or (ROOT / word).is_file(), word


def check_other(words: list[str]) -> None:
    """Assert that a command's files, targets of make, extras and flags of a script exist."""
    match words:
        case ["make", *targets]:
            names = [target for target in targets if "=" not in target and target[0] != "-"]
            rules = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
            assert set(names) <= set(rules)
        case ["python", "-m", module, *rest]:
            assert module == "pip" or importlib.util.find_spec(module), module
            for word in rest:
                assert_extras_and_files(word)
        case ["python", script, *rest]:
            folder = ROOT / "quadwalk/export" if script == "out/run_policy.py" else ROOT
            source = (folder / script.removeprefix("out/")).read_text()
            assert all(word in source for word in rest if word.startswith("--"))
        case [program, *rest]:
            assert program in OTHERS
            for word in rest if program.endswith("pip") else []:
                assert_extras_and_files(word)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_are_read_by_their_parsers(page, parse):
    for words in list_commands(page):
        call_words = arguments(words)
        if call_words is None:
            check_other(words)
            continue
        parse(*call_words)
        for variant in split_variants(call_words[1:])[0] if call_words[:1] == ["compare"] else []:
            with pytest.raises(ParsedError):
                parse_config(shlex.split(variant))


def test_flags_against_trouble_are_read_by_the_parser_of_a_task(parse):
    def is_read(*words: str) -> bool:
        try:
            parse("train", *words)
        except UsageError:
            return False
        return True

    flags = FLAGS.findall((ROOT / "docs/trouble.md").read_text())
    assert len(flags) > 20
    for text in flags:
        words = [PLACES.get(word, word) for word in shlex.split(text)]
        tasks = [[]] if "--resume" in words else [["run"], ["drive"], ["rough"]]
        assert any(is_read(*task, *words) for task in tasks), text
    assert not is_read("run", "--env.reward.fidget", "-5")  # which drive alone has


def test_the_readme_has_commands_and_a_wrong_flag_is_found(parse):
    assert len(list_commands(ROOT / "README.md")) > 10
    with pytest.raises(Exception, match="unknown option --enginee"):
        parse(*arguments(["python", "eval.py", "--enginee", "mujoco"]))
