"""Who imports whom: always what stands below, never round in a circle."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
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
    ("export", "identify", "view"),
    ("api",),
    ("gym", "experiments"),
    ("", "__main__", "cli.main", "cli.doctor", "eval", "robot.cli", "runs.cli", "terrain.cli"),
)


def imports() -> dict[str, set[str]]:
    """The package's modules, each with all that it imports anywhere, in functions too."""
    files = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in (ROOT / "quadwalk").rglob("*.py")
    }
    found: dict[str, set[str]] = {}
    for module, path in files.items():
        names: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{module}: a relative import"
                parts = (f"{node.module}.{alias.name}" for alias in node.names)
                names.update(part if part in files else str(node.module) for part in parts)
        found[module] = names
    return found


def layer(module: str) -> int:
    name = module.removeprefix("quadwalk").removeprefix(".")
    places = {part: at for at, parts in enumerate(LAYERS) for part in parts}
    while name not in places:
        name = name.rpartition(".")[0]
        assert name, f"{module} is in no layer"
    return places[name]


def test_no_import_goes_up():
    up = [
        f"{module} imports {other}"
        for module, others in imports().items()
        for other in others
        if other.startswith("quadwalk") and layer(other) > layer(module)
    ]
    assert not up


def test_imports_make_no_circle():
    graph = imports()
    assert len(graph) > 100  # it has seen the package
    TopologicalSorter(
        {module: names & graph.keys() for module, names in graph.items()}
    ).prepare()  # raises CycleError, which names the circle
