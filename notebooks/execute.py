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
    """Return the notebook at `path` with the outputs of its cells, which run in `folder`.

    The studies' results are copied to where the notebook looks for them, beside `folder`. Raises
    `nbclient.exceptions.CellExecutionError` for a cell that fails.
    """
    notebook = nbformat.read(path, as_version=4)
    copy_results(folder.parent)
    metadata = notebook.metadata.copy()
    run_cells(notebook, folder)
    notebook.metadata = metadata  # without what differs from one machine to the next
    drop_second_pictures(notebook)
    return notebook


def copy_results(folder: Path) -> None:
    """Copy the results of the studies to `folder`, in the same places as in the repository."""
    for results in (HERE.parent / "studies").glob("*/results.json"):
        copy = folder / results.relative_to(HERE.parent)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(results, copy)


def run_cells(notebook: nbformat.NotebookNode, folder: Path) -> None:
    """Run the cells of a notebook in `folder`, with this Python, and put their outputs in."""
    # Without folders of kernels, the one kernel that remains is this interpreter.
    kernels = KernelSpecManager(kernel_dirs=[])
    # Printed commands name no folder if the interpreter's environment is active.
    search_path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    NotebookClient(
        notebook,
        km=AsyncKernelManager(kernel_spec_manager=kernels),
        timeout=None,
        record_timing=False,
        coalesce_streams=True,
        resources={"metadata": {"path": str(folder)}},
    ).execute(cleanup_kc=True, env={**os.environ, "PATH": search_path})  # the kernel ends with it


def drop_second_pictures(notebook: nbformat.NotebookNode) -> None:
    """Drop each output's JPEG that shows the same picture as its PNG."""
    for output in list_outputs(notebook):
        if "image/png" in output.get("data", {}):
            output.data.pop("image/jpeg", None)


def list_outputs(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    """Return the outputs of all cells in their order."""
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def list_named_folders(notebook: nbformat.NotebookNode) -> list[str]:
    """List the folders of this machine that the outputs name; published ones name none."""
    # The letters that encode a picture may look like a folder by chance.
    readable = [
        {kind: data for kind, data in output.get("data", output).items() if kind[:6] != "image/"}
        for output in list_outputs(notebook)
    ]
    text = json.dumps(readable)
    folders = (HERE.parent, sys.prefix, Path.home(), tempfile.gettempdir())
    return [str(folder) for folder in folders if str(folder) in text]


def read_commit() -> str:
    """Return the last commit that changed the package or its assets."""
    git = ["git", "-C", str(HERE), "log", "-1", "--format=%h", "--", "../quadwalk", "../assets"]
    return subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()


def name_commit(notebook: nbformat.NotebookNode, seconds: float) -> None:
    """Write the commit and the duration of the outputs at the end of the first cell."""
    commit = read_commit()
    head = notebook.cells[0]
    text = re.sub(r"\n\n\*Executed at commit [^*]*\*$", "", head.source)
    minutes = max(1, round(seconds / 60))
    duration = f"in {minutes} min on {os.cpu_count()} cores"
    head.source = f"{text}\n\n*Executed at commit {commit}, {duration}.*"


def update_notebook(path: Path) -> None:
    """Run a notebook in an empty folder and write it with its outputs."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "notebooks"
        folder.mkdir()
        start = time.monotonic()
        notebook = execute(path, folder)
        seconds = time.monotonic() - start
    if folders := list_named_folders(notebook):
        sys.exit(f"{path.name} is left as it was, for its outputs name {', '.join(folders)}")
    name_commit(notebook, seconds)
    nbformat.write(notebook, path)


def main() -> None:
    """Run the notebooks that the command names, or all of them."""
    for path in [Path(name) for name in sys.argv[1:]] or sorted(HERE.glob("*.ipynb")):
        print(path.name, flush=True)
        update_notebook(path)


if __name__ == "__main__":
    main()
