"""Published robots in the page: how heavy each is, and whether the page's MuJoCo loads it.

    python benchmarks/page.py [--folder DIR] [--only a1 go2] [--markdown FILE]

Each quadruped of PyPI's example-robot-data, or of DIR, is written as `quadwalk export --web` writes
it, and loaded by MuJoCo's WebAssembly in Node.js. Sizes are of the MJCF with its meshes, packed as
in the single file. Needs the packages of the extra `zoo`, and Node.js with npm.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.shared import find_example_robots, make_parser
from benchmarks.zoo import find_quadrupeds, make_name
from quadwalk.cli.process import run_command
from quadwalk.robot.mjcf import write_xml
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.web import site, vendor
from quadwalk.web.decimate import decimate_visuals

SCRIPT = Path(__file__).parents[1] / "tests/web/run_policy.mjs"
HEAD = "| robot | MJCF in the page, kB | shapes | triangles | to see it |\n|---|---|---|---|---|"


def load_in_node(xml: str) -> dict[str, int]:
    """Load an MJCF, as text, by the page's MuJoCo in Node.js; return the sizes of its model.

    They are MuJoCo's numbers by name, such as `nq`, `ngeom` and `nmeshface`.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        site.write_folder(vendor.load_vendor_files(), folder)
        (folder / "package.json").write_text('{"type": "module"}')
        (folder / "robot.xml").write_text(xml)
        job = folder / "job.json"
        job.write_text(json.dumps({"models": [str(folder / "robot.xml")]}))
        command = ["node", str(SCRIPT), str(site.PAGE), str(folder / "vendor"), str(job)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    (sizes,) = json.loads(done.stdout)
    return dict(sizes)


def make_row(file: Path) -> str:
    """Return the row of the table for the URDF `file` of a quadruped, loaded in Node.js."""
    spec, note = decimate_visuals(load_quadruped(file).spec)
    xml = write_xml(spec)
    sizes = load_in_node(xml)
    assert sizes["nq"] == 19, sizes
    size = len(site.pack(xml.encode())) / 1e3
    return (
        f"| {make_name(file)} | {size:.0f} | {sizes['ngeom']} | {sizes['nmeshface']:,} | "
        f"{note or 'all'} |"
    )


def main() -> None:
    """Print the table of published robots, and write it to --markdown, if that is there."""
    parser = make_parser(__doc__)
    parser.add_argument("--folder", type=Path, help="of URDFs (default: example-robot-data's)")
    parser.add_argument("--only", nargs="+", default=[""], metavar="NAME", help="parts of paths")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="where the table goes")
    options = parser.parse_args()
    folder = options.folder or find_example_robots()
    if folder is None:
        sys.exit("error: example-robot-data is not installed; expected it, or --folder DIR")
    files = sorted(folder.rglob("*.urdf"))
    files = [file for file in files if any(name in str(file) for name in options.only)]
    lines = [HEAD]
    for file in find_quadrupeds(files):
        lines.append(make_row(file))
        print(lines[-1], flush=True)
    if options.markdown:
        options.markdown.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    run_command(main)
