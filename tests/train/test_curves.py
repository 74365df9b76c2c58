import math
import os
import struct
import subprocess
import sys

import pytest
from matplotlib import image

from quadwalk.errors import UserError
from quadwalk.train.progress.curves import plot_learning_curve


def rows(count, *keys, **fixed):
    return [
        {"steps": 1000 * (index + 1), **dict.fromkeys(keys, math.sqrt(index)), **fixed}
        for index in range(count)
    ]


FULL = rows(
    20,
    "train/speed",
    "train/fall_rate",
    "train/reward",
    "train/reward/forward",
    "train/reward/energy",
    "time/elapsed",
    "eval/speed",
    "eval/fall_rate",
)


@pytest.mark.parametrize(
    "metrics",
    [
        [],
        rows(1),
        rows(1, "train/speed"),
        FULL,
        FULL[:1],
        rows(5, "train/reward/only"),
        rows(5, **{"train/speed": math.nan, "train/fall_rate": math.inf, "train/reward": None}),
        rows(5, "train/speed", **{"time/elapsed": 3.0}),
        [{"steps": 0, "train/speed": 0.0}],
        rows(3, *(f"train/reward/term_{index}" for index in range(13))),
    ],
    ids=range(10),
)
def test_a_picture_whatever_is_known(tmp_path, metrics):
    path = tmp_path / "curve.png"
    plot_learning_curve(metrics, path)
    content = path.read_bytes()
    width, height = struct.unpack(">II", content[16:24])
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    assert width > 1000
    assert height > 300
    assert os.listdir(tmp_path) == ["curve.png"]


def test_the_curve_is_drawn_and_the_same_twice(tmp_path):
    for name, metrics in (("a", FULL), ("b", FULL), ("empty", rows(20))):
        plot_learning_curve(metrics, tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()

    def blue(name):
        red, _, blue = image.imread(tmp_path / name)[..., :3].transpose(2, 0, 1)
        return int(((blue - red) > 0.4).sum())

    assert blue("empty") == 0
    assert blue("a") > 200


def test_an_old_picture_survives_a_failure(tmp_path):
    plot_learning_curve([], tmp_path / "a.png")
    with pytest.raises(UserError, match=r"cannot write .*none/a\.png"):
        plot_learning_curve([], tmp_path / "none" / "a.png")


def test_matplotlib_waits_until_it_is_needed():
    program = "import sys, quadwalk.train.progress.curves; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
