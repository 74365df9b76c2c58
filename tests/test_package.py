"""What is shipped: a wheel with its assets."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_the_wheel_carries_package_assets_and_licences(tmp_path):
    pytest.importorskip("build")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", tmp_path]
    done = subprocess.run([*command, ROOT], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        for asset in (ROOT / "assets").iterdir():
            assert archive.read(f"quadwalk/assets/{asset.name}") == asset.read_bytes()
    modules = {path.relative_to(ROOT).as_posix() for path in (ROOT / "quadwalk").rglob("*.py")}
    assert modules <= names
    assert {"LICENSE", "NOTICE"} <= {Path(name).name for name in names}
