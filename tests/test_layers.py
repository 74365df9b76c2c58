"""Imports between modules: always of what stands below, never round in a circle."""

import ast
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in (ROOT / "quadwalk").rglob("*.py")
}
# From the ground up. A module imports from its own layer and from those before it; the longest of
# these names that it begins with is its place.
LAYERS = (
    ("errors", "bounds", "cores", "files", "paths", "brax", "cli.shell"),
    ("cli",),
    ("render",),
    ("robot",),
    ("terrain",),
    ("physics",),
    ("settings", "robot.load"),
    ("env",),
    ("tasks",),
    ("task_files", "settings.registry", "settings.serialize", "terms"),
    ("runs",),
    ("progress",),
    ("learn",),
    ("evaluation",),
    ("export", "identify"),
    ("web", "export.cli"),
    ("api",),
    ("gym", "experiments"),
    ("", "__main__", "cli.main", "cli.doctor", "eval", "robot.cli", "runs.cli", "terrain.cli"),
)


def find_imports(source: str) -> set[str]:
    """Return the modules that a module imports anywhere, in functions and by strings too."""
    tree = ast.parse(source)
    docstrings = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    modules: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"a relative import of {node.module}"
            names = (f"{node.module}.{alias.name}" for alias in node.names)
            modules.update(name if name in FILES else str(node.module) for name in names)
        elif isinstance(node, ast.Constant) and node not in docstrings:
            modules.update(find_module_names(str(node.value)))
    return modules


def find_module_names(text: str) -> Iterator[str]:
    """Yield the modules of the package that a string names, such as "quadwalk.env.rewards:fall"."""
    for name in re.findall(r"\bquadwalk(?:\.\w+)+", text):
        while name not in FILES:
            name = name.rpartition(".")[0]
        if name != "quadwalk":
            yield name


IMPORTS = {module: find_imports(path.read_text()) for module, path in FILES.items()}


def find_layer(module: str) -> int:
    """Return the place of a module in `LAYERS`."""
    name = module.removeprefix("quadwalk").removeprefix(".")
    places = {part: place for place, parts in enumerate(LAYERS) for part in parts}
    while name not in places:
        name = name.rpartition(".")[0]
        assert name, f"{module} is in no layer"
    return places[name]


def test_no_import_goes_up():
    up = [
        f"{module} imports {other}"
        for module, others in IMPORTS.items()
        for other in others
        if other.startswith("quadwalk") and find_layer(other) > find_layer(module)
    ]
    assert not up


def test_imports_make_no_circle():
    assert len(IMPORTS) > 100  # it has seen the package
    graph = {module: names & FILES.keys() - {module} for module, names in IMPORTS.items()}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_an_import_in_a_string_is_seen():
    source = (
        '"""See quadwalk.api."""\ntable = {"a": "quadwalk.env.rewards:fall", "b": "quadwalk.x"}'
    )
    assert find_imports(source) == {"quadwalk.env.rewards"}
