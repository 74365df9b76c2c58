"""Write docs/api.md from the source of the public Python API: `python docs/site/api.py`."""

import dataclasses
import inspect
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[0]))  # settings.py stands beside this file
sys.path.insert(0, str(Path(__file__).parents[2]))  # the page describes the package of this folder

from settings import read_comments

from quadwalk import api, gym
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.results import Evaluation
from quadwalk.learn.acting import Policy
from quadwalk.runs.directory import Run

PAGE = Path(__file__).parents[1] / "api.md"
FUNCTIONS = (api.make, api.train, api.evaluate, api.compare, api.load_policy, api.play)
# The classes that these functions return and take, with the members that a user calls.
CLASSES: dict[type, tuple[str, ...]] = {
    QuadrupedEnv: ("reset", "step", "to_engine"),
    Run: (),
    Evaluation: (
        "summary",
        "typical",
        "gait",
        "origin",
        "results",
        "film_strip",
        "report",
        "save_mcap",
    ),
    Policy: (),
    gym.QuadrupedGymEnv: ("reset", "step"),
    gym.QuadrupedGymVectorEnv: ("reset", "step"),
}
LONGEST = 88  # characters of a signature in one line
HEAD = """# Python

`import quadwalk` gives `make`, `train`, `evaluate`, `compare`, `load_policy` and `play`. The
classes below are what these return. `import quadwalk.gym` registers the tasks with
[Gymnasium](gymnasium.md).
`python docs/site/api.py` wrote this page from the source.
"""


def format_docstring(documented: Any) -> str:
    """Return a docstring as Markdown, with each section of arguments as a list."""
    text = inspect.getdoc(documented) or ""
    text = re.sub(r"^(Args|Attributes):$", r"**\1**\n", text, flags=re.MULTILINE)
    # In Markdown, an argument's text is one line.
    text = re.sub(r"\n {8,}(?=\S)", " ", text)
    return re.sub(r"^ {4}([\w, ]+): ", r"- `\1`: ", text, flags=re.MULTILINE).strip()


def format_signature(name: str, function: Any) -> str:
    """Return the signature of a function, in one line or with a line for each parameter."""
    signature = inspect.signature(function)
    parameters = list_parameters(signature)
    end = format_return_type(signature)
    text = f"{name}({', '.join(parameters)}){end}"
    if len(text) > LONGEST:
        text = f"{name}(\n    " + ",\n    ".join(parameters) + f",\n){end}"
    return strip_modules(text)


def list_parameters(signature: inspect.Signature) -> list[str]:
    """Return the parameters of a signature as in source, without `self`."""
    parameters = [each for each in signature.parameters.values() if each.name != "self"]
    texts = [str(parameter) for parameter in parameters]
    kinds = [parameter.kind for parameter in parameters]
    if inspect.Parameter.KEYWORD_ONLY in kinds:
        texts.insert(kinds.index(inspect.Parameter.KEYWORD_ONLY), "*")
    return texts


def format_return_type(signature: inspect.Signature) -> str:
    """Return the arrow and the type at the end of a signature, or "" if it returns nothing."""
    annotation = signature.return_annotation
    if annotation is signature.empty or annotation is None:
        return ""
    return f" -> {annotation.__name__ if isinstance(annotation, type) else annotation}"


def strip_modules(text: str) -> str:
    """Return a signature without the modules and the quotes of its types."""
    text = re.sub(r"\b(?:[a-z_0-9]+\.)+(?=[A-Z])", "", text)
    return re.sub(r"'([A-Z]\w*)'", r"\1", text)


def format_function(name: str, function: Any, level: str = "##") -> str:
    """Return the entry of a function or method: heading, signature and docstring."""
    heading = f"{level} {name.rpartition('.')[2]}"
    signature = f"```python\n{format_signature(name, function)}\n```"
    return f"{heading}\n\n{signature}\n\n{format_docstring(function)}"


def format_member(owner: type, name: str) -> str:
    """Return the entry of a method or property."""
    member = inspect.getattr_static(owner, name)
    if inspect.isfunction(member):
        return format_function(f"{owner.__name__}.{name}", member, "###")
    return f"### {name}\n\nA property. {format_docstring(member)}"


def format_fields(owner: type) -> str:
    """Return the list of a dataclass's fields that have a comment."""
    comments = read_comments(owner)
    names = [field.name for field in dataclasses.fields(owner)]
    return "\n".join(f"- `{name}`: {comments[name]}" for name in names if comments[name])


def format_class(owner: type, members: tuple[str, ...]) -> str:
    """Return the entry of a class: docstring, then its fields or these members."""
    parts = [f"## {owner.__name__}", format_docstring(owner)]
    if not members and dataclasses.is_dataclass(owner):
        parts += filter(None, [format_fields(owner)])
    parts += [format_member(owner, name) for name in members]
    return "\n\n".join(parts)


def format_page() -> str:
    """Return the whole page."""
    functions = [format_function(f"quadwalk.{each.__name__}", each) for each in FUNCTIONS]
    classes = [format_class(owner, members) for owner, members in CLASSES.items()]
    return "\n\n".join([HEAD.rstrip(), *functions, *classes]) + "\n"


if __name__ == "__main__":
    PAGE.write_text(format_page())
    print(f"wrote {PAGE}")
