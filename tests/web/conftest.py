"""The packaged policies as the page has them, and Node to run its modules."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from quadwalk.evaluation.load import LoadedRun
from quadwalk.export.bundle import load_flat
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run
from quadwalk.web import site, vendor

NAMES = ("drive", "getup", "rough", "run", "walk")
SCRIPTS = Path(__file__).parent


@pytest.fixture(scope="session")
def vendor_files() -> dict[str, bytes]:
    """The page's third-party files; tests that need them are skipped where npm is missing."""
    if shutil.which("npm") is None and not (vendor.FOLDER / "vendor").exists():
        pytest.skip("no npm, which fetches the page's third-party files")
    return vendor.load_vendor_files()


@pytest.fixture(scope="session")
def loaded_runs() -> dict[str, LoadedRun]:
    """The packaged policies, loaded as they are exported."""
    return {name: load_flat(Run(PRETRAINED / name), "last") for name in NAMES}


@pytest.fixture(scope="session")
def robot_files(loaded_runs, tmp_path_factory) -> Path:
    """A folder with the page's robots, each policy alone and `drive` with `getup`."""
    folder = tmp_path_factory.mktemp("robots")
    for loaded in loaded_runs.values():
        site.write_folder(site.make_dog(loaded).files, folder)
    terrain = site.make_ground(loaded_runs["rough"].env)
    (folder / site.TERRAIN).write_bytes(site.pack_ground(terrain))
    return folder


@pytest.fixture(scope="session")
def run_node(vendor_files, tmp_path_factory) -> Callable[..., Any]:
    """Run a job of run_policy.mjs, or of another script beside it, in Node; return its answer."""
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
