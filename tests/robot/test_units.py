"""Limits in degrees, lengths in millimeters, masses in grams: refused, with the likely unit."""

import math
import re
from dataclasses import replace

import pytest

from quadwalk.robot.cli import main
from quadwalk.robot.quadruped import make_quadruped
from quadwalk.robot.report import UrdfError
from quadwalk.robot.urdf import parse_urdf
from tests.robot.robots import Walker

SMALL = Walker(size=0.3, mass=0.02)  # legs of 12 cm, 0.24 kg
DEGREES = Walker(hip=(-46, 46), thigh=(-60, 170), calf=(-150, -35))


@pytest.mark.parametrize(
    ("walker", "reason"),
    [
        (DEGREES, "joint 'FR_hip_joint' has limits of -46 and 46 rad; .*2 pi.*degrees"),
        (Walker(calf=(-150, -35)), "joint 'FR_calf_joint' .*degrees"),
        (Walker(thigh=(-10, 90)), "joint 'FR_thigh_joint' .*degrees"),
        (Walker(thigh=(-1, 7)), "joint 'FR_thigh_joint' has limits of -1 and 7 rad"),
        (Walker(size=1000), "legs are 400 m long; expected 0.01 to 2.5 m .*millimeters"),
        (replace(SMALL, size=300), "legs are 120 m long; .*millimeters"),
        (Walker(size=100), "legs are 40 m long; .*centimeters"),
        (Walker(size=1 / 0.0254), "legs are 15.* m long; .*inches"),
        (Walker(size=1e-3), "legs are 0.0004 m long; .*1e.03 times too short"),
        (Walker(mass=1000), "masses add up to 12000 kg, .* grams"),
        (replace(SMALL, mass=20), "masses add up to 240 kg, .* grams"),
        (Walker(mass=1e-3), "masses add up to 0.012 kg, .* tonnes"),
        (Walker(size=1000, mass=1000), "legs are 400 m long; .*millimeters"),
    ],
)
def test_units_of_no_quadruped_are_refused(walker, reason):
    with pytest.raises(UrdfError) as raised:
        make_quadruped(parse_urdf(walker.text(), "dog.urdf"))
    assert re.match(f"dog.urdf: {reason}", str(raised.value)), raised.value
    assert "expected" in str(raised.value)


@pytest.mark.parametrize(
    "walker",
    [
        SMALL,
        Walker(size=2.5, mass=15),  # legs of 1 m, 180 kg
        Walker(mass=0.3),
        Walker(mass=4),
        Walker(hip=(-9.42, 9.42), thigh=(-10, 10)),  # as ANYmal and Solo12 have them: none
        Walker(hip=(-math.tau, math.tau), thigh=(-1, 6.28)),
    ],
)
def test_quadrupeds_of_all_sizes_are_read(walker):
    assert make_quadruped(parse_urdf(walker.text())).trunk == "trunk"


def test_an_inertia_in_another_unit_is_said():
    (note,) = _inertia_notes(Walker(inertia=1e6))
    assert ": trunk 100 m, " in note  # the square root of 1.5 * 0.04e6 kg m^2 / 6 kg
    assert not _inertia_notes(Walker())
    assert not _inertia_notes(SMALL)


def _inertia_notes(walker: Walker) -> list[str]:
    notes = make_quadruped(parse_urdf(walker.text())).notes
    return [note for note in notes if "wider than the robot" in note]


def test_the_command_says_why_it_does_not_train(tmp_path, capsys):
    file = tmp_path / "dog.urdf"
    file.write_text(Walker(size=1000).text())
    main([str(file), "-o", str(tmp_path / "dog.xml")])
    assert "trains as a quadruped: no: legs are 400 m long" in capsys.readouterr().err
