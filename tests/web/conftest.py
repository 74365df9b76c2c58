"""The packaged policies as the page has them, and Node to run its modules."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import onnx
import pytest
from google.protobuf.json_format import Parse

from quadwalk.evaluation.load import LoadedRun
from quadwalk.export.bundle import load_flat
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run
from quadwalk.web import site, vendor

NAMES = ("drive", "getup", "rough", "run", "walk")
SCRIPTS = Path(__file__).parent


@pytest.fixture(scope="session")
def vendor_files() -> dict[str, bytes]:
    """Return the content of the page's third-party files by name; without npm, skip the test."""
    if shutil.which("npm") is None and not (vendor.FOLDER / "vendor").exists():
        pytest.skip("no npm, which fetches the page's third-party files")
    return vendor.load_vendor_files()


@pytest.fixture(scope="session")
def loaded_runs() -> dict[str, LoadedRun]:
    """Return the packaged policies by name, loaded on flat ground as they are exported."""
    return {name: load_flat(Run(PRETRAINED / name), "last") for name in NAMES}


@pytest.fixture(scope="session")
def robot_files(loaded_runs, tmp_path_factory) -> Path:
    """Return a folder with the page's files of each packaged policy, NAME.onnx, and the terrain.

    The terrain is that of `rough`, as the page loads it.
    """
    folder = tmp_path_factory.mktemp("robots")
    for name, loaded in loaded_runs.items():
        files = site.make_dog(loaded).files
        site.write_folder(files, folder)
        model = Parse(files[site.make_policy_name(name)], onnx.ModelProto())
        onnx.save(model, folder / f"{name}.onnx")
    terrain = site.make_ground(loaded_runs["rough"].env)
    (folder / site.TERRAIN).write_bytes(site.pack_ground(terrain))
    return folder


@pytest.fixture(scope="session")
def run_node(vendor_files, tmp_path_factory) -> Callable[..., Any]:
    """Return a function that runs a job of run_policy.mjs in Node and returns its answer.

    It can run another `script` of this folder too. Job and answer are JSON. Without Node.js, skip
    the test.
    """
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node.js, in which the page's modules run")
    folder = tmp_path_factory.mktemp("node")
    site.write_folder(vendor_files, folder)
    (folder / "package.json").write_text('{"type": "module"}')

    def run(job: dict[str, Any], script: str = "run_policy.mjs") -> Any:
        file = folder / "job.json"
        file.write_text(json.dumps(job))
        command = [node, str(SCRIPTS / script), str(site.PAGE), str(folder / "vendor"), str(file)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run
