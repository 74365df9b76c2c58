"""The wheel that is shipped, with its assets."""

import os
import zipfile
from pathlib import Path

import pytest

import quadwalk
from tests.programs import ROOT, python


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    pytest.importorskip("build")
    folder = tmp_path_factory.mktemp("wheel")
    done = python("-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT)
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("*.whl")
    return built


def test_the_wheel_carries_package_assets_and_licenses(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        assets = ROOT / "assets"
        for asset in filter(Path.is_file, assets.rglob("*")):
            name = asset.relative_to(assets).as_posix()
            assert archive.read(f"quadwalk/assets/{name}") == asset.read_bytes()
    modules = {path.relative_to(ROOT).as_posix() for path in (ROOT / "quadwalk").rglob("*.py")}
    assert modules | {"quadwalk/py.typed"} <= names
    assert {"LICENSE", "NOTICE"} <= {Path(name).name for name in names}
    assert wheel.name.startswith(f"quadwalk-{quadwalk.__version__}-")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("", "train eval export robot"),
        ("train --help-all", "--env.reward.energy --env.physics-dt"),
        ("eval --help", "--episodes"),
        ("export --help", "--policy"),
        ("robot {assets}/aliengo.urdf -q", '<mujoco model="aliengo">'),
    ],
)
def test_its_commands_work_away_from_the_checkout(wheel, tmp_path, arguments, words):
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    command = arguments.format(assets=site / "quadwalk/assets").split()
    environment = {**os.environ, "PYTHONPATH": str(site)}
    done = python("-m", "quadwalk", *command, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
    assert all(word in done.stdout for word in words.split())


def test_libraries_print_nothing_when_they_are_imported():
    code = "import quadwalk.api, sys; assert 'mujoco.mjx.warp' in sys.modules"
    done = python("-c", code)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
