"""`python docs/site/api.py`: write docs/api.md from the public Python API's own source."""

import dataclasses
import inspect
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[0]))
sys.path.insert(0, str(Path(__file__).parents[2]))  # the package beside which it stands

from settings import comments

from quadwalk import api, gym
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.results import Evaluation
from quadwalk.learn.acting import Policy
from quadwalk.runs.directory import Run

PAGE = Path(__file__).parents[1] / "api.md"
FUNCTIONS = (api.make, api.train, api.evaluate, api.compare, api.load_policy, api.play)
# What they return and take, and of each the members that a user calls.
CLASSES: dict[type, tuple[str, ...]] = {
    QuadrupedEnv: ("reset", "step", "to_engine"),
    Run: (),
    Evaluation: (
        *("summary", "typical", "gait", "origin", "results"),
        *("film_strip", "report", "save_mcap"),
    ),
    Policy: (),
    gym.QuadrupedGymEnv: ("reset", "step"),
    gym.QuadrupedGymVectorEnv: ("reset", "step"),
}
HEAD = """# Python

`import quadwalk` gives `make`, `train`, `evaluate`, `compare`, `load_policy` and `play`. The
classes below are what these return. `import quadwalk.gym` registers the tasks with
[Gymnasium](gymnasium.md).
`python docs/site/api.py` wrote this page from the source.
"""


def said(thing: Any) -> str:
    """A docstring as Markdown: sections of arguments as lists."""
    text = inspect.getdoc(thing) or ""
    text = re.sub(r"^(Args|Attributes):$", r"**\1**\n", text, flags=re.MULTILINE)
    # Wherever an argument's text goes on in the next line.
    text = re.sub(r"\n {8,}(?=\S)", " ", text)
    return re.sub(r"^ {4}([\w, ]+): ", r"- `\1`: ", text, flags=re.MULTILINE).strip()


def signature(name: str, thing: Any) -> str:
    """How it is called, a parameter a line where it is long."""
    found = inspect.signature(thing)
    parameters = [str(each) for each in found.parameters.values() if each.name != "self"]
    kinds = [each.kind for each in found.parameters.values() if each.name != "self"]
    if inspect.Parameter.KEYWORD_ONLY in kinds:
        parameters.insert(kinds.index(inspect.Parameter.KEYWORD_ONLY), "*")
    returned = found.return_annotation
    end = "" if returned is found.empty or returned is None else f" -> {name_of(returned)}"
    line = f"{name}({', '.join(parameters)}){end}"
    if len(line) > 88:
        line = f"{name}(\n    " + ",\n    ".join(parameters) + f",\n){end}"
    return shortened(line)


def name_of(annotation: Any) -> str:
    """A type as one writes it."""
    return annotation.__name__ if isinstance(annotation, type) else str(annotation)


def shortened(text: str) -> str:
    """`text` without the modules of types."""
    text = re.sub(r"\b(?:[a-z_0-9]+\.)+(?=[A-Z])", "", text)
    return re.sub(r"'([A-Z]\w*)'", r"\1", text)


def function(name: str, thing: Any, level: str = "##") -> str:
    """The entry of a function or method."""
    heading = name.rpartition(".")[2]
    return f"{level} {heading}\n\n```python\n{signature(name, thing)}\n```\n\n{said(thing)}"


def member(owner: type, name: str) -> str:
    """The entry of a method or property."""
    thing = inspect.getattr_static(owner, name)
    if inspect.isfunction(thing):
        return function(f"{owner.__name__}.{name}", thing, "###")
    return f"### {name}\n\nA property. {said(thing)}"


def page() -> str:
    """The whole page."""
    parts = [HEAD.rstrip(), *(function(f"quadwalk.{f.__name__}", f) for f in FUNCTIONS)]
    for owner, names in CLASSES.items():
        parts.append(f"## {owner.__name__}\n\n{said(owner)}")
        if not names and dataclasses.is_dataclass(owner):
            told = comments(owner)
            lines = [f"- `{each.name}`: {told[each.name]}" for each in dataclasses.fields(owner)]
            lines = [line for line in lines if not line.endswith(": ")]
            parts += ["\n".join(lines)] if lines else []
        parts += [member(owner, name) for name in names]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"wrote {PAGE}")
