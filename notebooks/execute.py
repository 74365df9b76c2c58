"""Run the notebooks, each from a clean kernel, and keep what they show: `make notebooks`."""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import nbformat
from jupyter_client.kernelspec import KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient

HERE = Path(__file__).resolve().parent


def execute(path: Path, folder: Path) -> nbformat.NotebookNode:
    """The notebook at `path` with the outputs of its cells, run by this Python in `folder`.

    The studies' results are copied to where the notebook looks for them, beside `folder`. Raises
    `nbclient.exceptions.CellExecutionError` for a cell that fails.
    """
    notebook = nbformat.read(path, as_version=4)
    for data in (HERE.parent / "studies").glob("*/results.json"):
        place = folder.parent / data.relative_to(HERE.parent)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(data, place)
    metadata = notebook.metadata.copy()
    # Among no folders of kernels, what is left is this interpreter's own.
    kernels = KernelSpecManager(kernel_dirs=[])
    # As where this interpreter's environment is active: printed commands name no folder then.
    active = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    NotebookClient(
        notebook,
        km=AsyncKernelManager(kernel_spec_manager=kernels),
        timeout=None,
        record_timing=False,
        coalesce_streams=True,
        resources={"metadata": {"path": str(folder)}},
    ).execute(cleanup_kc=True, env={**os.environ, "PATH": active})  # the kernel ends with it
    notebook.metadata = metadata  # without what differs from one machine to the next
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                output.data.pop("image/jpeg", None)  # the same picture once more
    return notebook


def folders_named(notebook: nbformat.NotebookNode) -> list[str]:
    """Folders of this machine that the outputs name; what is published should name none."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    for_readers = [
        {kind: data for kind, data in output.get("data", output).items() if kind[:6] != "image/"}
        for output in outputs
    ]
    text = json.dumps(for_readers)
    folders = (HERE.parent, sys.prefix, Path.home(), tempfile.gettempdir())
    return [str(folder) for folder in folders if str(folder) in text]


def name_commit(notebook: nbformat.NotebookNode, seconds: float) -> None:
    """Say at the end of its first cell which commit its outputs are of, and how long they took."""
    git = ["git", "-C", str(HERE), "log", "-1", "--format=%h", "--", "../quadwalk", "../assets"]
    commit = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    head = notebook.cells[0]
    text = re.sub(r"\n\n\*Executed at commit [^*]*\*$", "", head.source)
    minutes = max(1, round(seconds / 60))
    duration = f"in {minutes} min on {os.cpu_count()} cores"
    head.source = f"{text}\n\n*Executed at commit {commit}, {duration}.*"


def main() -> None:
    """Run those that are named, or all."""
    for path in [Path(name) for name in sys.argv[1:]] or sorted(HERE.glob("*.ipynb")):
        print(path.name, flush=True)
        with tempfile.TemporaryDirectory() as parent:
            folder = Path(parent) / "notebooks"
            folder.mkdir()
            start = time.monotonic()
            notebook = execute(path, folder)
            seconds = time.monotonic() - start
        if named := folders_named(notebook):
            sys.exit(f"{path.name} is left as it was, for its outputs name {', '.join(named)}")
        name_commit(notebook, seconds)
        nbformat.write(notebook, path)


if __name__ == "__main__":
    main()
