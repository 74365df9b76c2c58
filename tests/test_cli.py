from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import pytest
import tyro

from quadwalk.cli.arguments import parse
from quadwalk.errors import UsageError, UserError


@dataclass(frozen=True)
class Motor:
    step_limit: float | None = None  # rad
    bounds: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True)
class Config:
    """A test."""

    names: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    steps: int = 3  # how many
    kind: Literal["new", "old"] = "new"
    out: Path = Path("out")
    quiet: bool = False
    motor: Motor = field(default_factory=Motor)

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise UsageError(f"--steps is {self.steps}; expected 1 or more")
        if self.steps > 100:
            raise ValueError("too\nmany")


def test_flags_change_the_default():
    default = Config(steps=5, motor=Motor(bounds=(1.0, 2.0)))
    flags = "a b --kind=old --quiet --motor.step-limit 0.5 --motor.bounds 3 4"
    expected = Config(("a", "b"), 5, "old", quiet=True, motor=Motor(0.5, (3.0, 4.0)))
    assert parse(Config, flags.split(), "prog", default) == expected


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--steps x", "bad value for --steps; expected INT"),
        ("--steps", "bad value for --steps; expected INT"),
        ("--kind middle", "bad value for --kind; expected {new,old}"),
        ("--motor.bounds 1", "bad value for --motor.bounds; expected FLOAT FLOAT"),
        ("--motor.step-limit x", "bad value for --motor.step-limit; expected FLOAT or None"),
        (
            "--motor.step-limit --quiet",
            "bad value for --motor.step-limit; expected FLOAT or None, and for a value that begins "
            "with a dash --motor.step-limit=--quiet",
        ),
        ("--stepz 4", "unknown option --stepz; did you mean '--steps'?"),
        ("--motor.bonds 1 2", "unknown option --motor.bonds; did you mean '--motor.bounds'?"),
        ("--utterly=1 --nonsense 2", "unknown option --utterly=1, --nonsense"),
        ("--steps 101", "too many"),
    ],
)
@pytest.mark.parametrize("width", ["30", "200"])
def test_a_bad_flag_is_one_line_that_says_what_is_expected(
    monkeypatch, capsys, flags, message, width
):
    monkeypatch.setenv("COLUMNS", width)
    with pytest.raises(UsageError) as caught:
        parse(Config, flags.split(), "prog")
    assert str(caught.value) == f"{message} (prog --help lists all)"
    assert capsys.readouterr() == ("", "")


def test_what_the_settings_themselves_refuse_passes_through():
    with pytest.raises(UsageError, match=r"^--steps is 0; expected 1 or more$"):
        parse(Config, ["--steps", "0"], "prog")


def test_help_is_printed_and_ends_the_program(capsys):
    with pytest.raises(SystemExit) as stop:
        parse(Config, ["--help"], "prog")
    assert stop.value.code == 0
    assert "how many" in capsys.readouterr().out


def test_an_error_is_one_line_whatever_it_quotes():
    assert str(UserError("no task 'a\nb'; expected one")) == "no task 'a b'; expected one"
