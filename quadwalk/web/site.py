"""The page's files: its own modules, third-party ones, and the robots that it shows."""

import base64
import gzip
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np
from google.protobuf.json_format import MessageToJson

from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UserError
from quadwalk.evaluation.load import LoadedRun, make_unseen_ground
from quadwalk.export.description import make_policy_model
from quadwalk.export.policy_graph import JointTargets, find_joint_targets
from quadwalk.robot.mjcf import write_xml
from quadwalk.task_files import is_from_task_file, load_task
from quadwalk.terrain.terrain import Terrain, make_terrain, measure_leg
from quadwalk.web.decimate import decimate_visuals
from quadwalk.web.vendor import load_vendor_files

PAGE = Path(__file__).parent / "page"
INDEX, DOGS, TERRAIN = "index.html", "dogs.json", "terrain.json"
LIVE_MODULES = ("single.js", "desk.js", "dials.js")  # that no other module needs at its start
HEIGHT_STEP = 0.001  # m, in which heights are written
GROUND_TASK = "rough"  # whose kinds of ground the page offers
GROUND_LEVELS = (0.4, 1.0)  # difficulties of each
_MODULE = re.compile(r'from "(?:\./)?([^"]+)"')
# Where modules of npm's packages are; the import map of index.html says the same.
_PLACES = {
    "three": "vendor/three.module.js",
    "@mujoco/mujoco": "vendor/mujoco.js",
    "./three.core.js": "vendor/three.core.js",
}


@dataclass(frozen=True)
class Dog:
    """One robot of the page: its policies and its MJCF by the names of their files."""

    name: str
    files: dict[str, bytes]
    policies: dict[str, str]  # files of what may drive it, by label; the first drives
    getup: str | None  # file of the policy that gets it up
    remote: bool  # it acts in Python, where the page asks for its joint targets
    note: str | None  # what was done to its meshes

    def to_json(self) -> bytes:
        """Return the file that the page reads first of it."""
        parts = {
            "name": self.name,
            "robot": f"{self.name}.xml",
            "policies": self.policies,
            "getup": self.getup,
            "remote": self.remote,
            "note": self.note,
        }
        return json.dumps(parts).encode()


def make_entry_name(dog: str) -> str:
    """Return the name of the file that the page reads first of a robot."""
    return f"{dog}.dog.json"


def make_dog(loaded: LoadedRun, getup: LoadedRun | None = None, remote: bool = False) -> Dog:
    """Return the robot of a run, with the policy that gets it up.

    A `remote` policy acts in Python.
    """
    name = loaded.run.name
    spec, note = decimate_visuals(loaded.env.quadruped.spec)
    files = {f"{name}.xml": write_xml(spec).encode()}
    policy = make_policy_name(name)
    files[policy] = pack_policy(loaded)
    riser = None
    if getup is not None:
        riser = make_policy_name(f"{name}.getup")
        files[riser] = pack_policy(getup)
    return Dog(name, files, {"last": policy}, riser, remote, note)


def make_policy_name(name: str) -> str:
    """Return the name of a policy's file."""
    return f"{name}.policy.json"


def pack_policy(loaded: LoadedRun) -> bytes:
    """Return a policy as onnx.js reads it: the ONNX of `quadwalk export` in protobuf's JSON."""
    env = loaded.env
    try:
        targets = find_joint_targets(env.config.action, env.robot)
    except UserError:  # then it acts in Python, and its file has only its weights and metadata
        limits = np.asarray(env.robot.lower), np.asarray(env.robot.upper)
        targets = JointTargets(np.zeros((12, 12)), np.asarray(env.robot.home_joints), *limits)
    return MessageToJson(make_policy_model(loaded, targets), indent=None).encode()


def make_ground(env: QuadrupedEnv) -> Terrain:
    """Return a field of every kind of ground, as high and wide as suits the legs of the robot."""
    ground = make_unseen_ground(load_task(GROUND_TASK).env.ground, 0, len(GROUND_LEVELS))
    kinds = tuple(kind for kind in ground.kinds if kind != "flat")
    config = replace(ground, kinds=kinds, difficulty=GROUND_LEVELS)
    return make_terrain(config, measure_leg(env.mj_model, env.quadruped.feet[0]))


def pack_ground(terrain: Terrain) -> bytes:
    """Return a field of heights as the JSON that terrain.js reads."""
    heights = terrain.field.heights
    low = float(heights.min())
    units = np.round((heights - low) / HEIGHT_STEP).astype("<u2")
    rows, columns = heights.shape
    tiles = [
        {"kind": tile.kind, "difficulty": tile.difficulty, "start": tile.start}
        for tile in terrain.tiles
    ]
    value = {
        "rows": rows,
        "columns": columns,
        "cell": terrain.field.cell,
        "origin": terrain.field.origin,
        "low": low,
        "step": HEIGHT_STEP,
        "heights": pack(units.tobytes()),
        "tiles": tiles,
    }
    return json.dumps(value).encode()


def pack(content: bytes) -> str:
    """Return bytes as gzip in base64."""
    return base64.b64encode(gzip.compress(content, mtime=0)).decode()


def make_site(
    dogs: list[Dog], terrain: Terrain | None, live: bool = False, others: Iterable[str] = ()
) -> dict[str, bytes]:
    """Return the page's files by name, with robots `dogs` on `terrain`; None: a flat floor.

    A `live` page connects to the program that serves it, which sends newer policies. It offers
    the robots named in `others` too, whose files the program makes when they are chosen.
    """
    files = {path.name: path.read_bytes() for path in PAGE.iterdir() if path.is_file()}
    files |= load_vendor_files()
    for dog in dogs:
        files |= dog.files | {make_entry_name(dog.name): dog.to_json()}
    if terrain is not None:
        files[TERRAIN] = pack_ground(terrain)
    index = {
        "dogs": [*(dog.name for dog in dogs), *others],
        "terrain": None if terrain is None else TERRAIN,
        "live": live,
    }
    return files | {DOGS: json.dumps(index).encode()}


def to_single_file(files: Mapping[str, bytes]) -> bytes:
    """Return a page as one HTML file, which opens without a server or a network."""
    modules = order_modules(files)
    inside = {
        name: pack(content)
        for name, content in files.items()
        if not name.endswith((".html", ".css", ".txt", *LIVE_MODULES))
    }
    # A file that is packed already is packed once, and its name without the end stands for it.
    inside["vendor/mujoco.wasm.gz"] = base64.b64encode(files["vendor/mujoco.wasm.gz"]).decode()
    policy = (
        "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob:; "
        "style-src 'unsafe-inline'; img-src data: blob:; media-src blob:; connect-src data: blob:"
    )
    html = files[INDEX].decode()
    html = re.sub(r'(Content-Security-Policy"\s+content=)"[^"]*"', rf'\1"{policy}"', html)
    html = html.replace(
        '<link rel="stylesheet" href="style.css" />',
        f"<style>{files['style.css'].decode()}</style>",
    )
    html = re.sub(r'\s*<script type="importmap">.*?</script>', "", html, flags=re.DOTALL)
    start = (
        f"<script>QUADWALK_FILES = {json.dumps(inside)}; QUADWALK_MODULES = {json.dumps(modules)};"
        f"QUADWALK_PLACES = {json.dumps(_PLACES)};</script>\n"
        f"    <script>{files['single.js'].decode()}</script>"
    )
    return html.replace('<script type="module" src="main.js"></script>', start).encode()


def order_modules(files: Mapping[str, bytes]) -> list[str]:
    """Return the modules that main.js needs, and itself, each after those that it imports."""
    graph: dict[str, set[str]] = {"vendor/three.core.js": set(), "vendor/mujoco.js": set()}
    graph["vendor/three.module.js"] = {"vendor/three.core.js"}
    waiting = ["main.js"]
    while waiting:
        name = waiting.pop()
        if name in graph:
            continue
        targets = _MODULE.findall(files[name].decode())
        graph[name] = {_PLACES.get(target, target) for target in targets}
        waiting += graph[name]
    return list(TopologicalSorter(graph).static_order())


def write_folder(files: Mapping[str, bytes], out: Path) -> None:
    """Write a page's files into the folder `out`."""
    for name, content in files.items():
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def is_python_needed(loaded: LoadedRun) -> bool:
    """Return True for a policy that `check_shareable` refuses: it acts only in Python."""
    try:
        check_shareable(loaded)
    except UserError:
        return True
    return False


def check_shareable(loaded: LoadedRun) -> None:
    """Raise `UserError` where a policy needs Python, which no browser runs.

    It does with an observation from a task file, or an action map that is not linear.
    """
    for name, part in loaded.env.config.observation.items():
        if is_from_task_file(part.function):
            raise UserError(
                f"{loaded.run.path}: its observation {name!r} is Python of your own, which no "
                "browser runs; expected those of quadwalk. quadwalk view shows it on this machine"
            )
    find_joint_targets(loaded.env.config.action, loaded.env.robot)
