"""Terms: functions with their numbers, the parts of rewards, observations and terminations."""

import inspect
import reprlib
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, ClassVar

import jax
import numpy as np
import tyro

from quadwalk.bounds import Bounds, NotNegative, check_value
from quadwalk.errors import UsageError, UserError, find_line

# On the command line a term's parameters are named after the term, without a word between them;
# where there are none there is no flag, which is why the type is not narrower.
Params = Annotated[Any, tyro.conf.arg(name="")]


@dataclass(frozen=True)
class Term:
    """A pure function of the task and its parameters."""

    gives: ClassVar[str] = "a number"  # the expected value, in words

    function: tyro.conf.Suppress[Callable[..., Any]]
    params: Params = None  # keyword arguments of the function: a dict of numbers, or None

    def __post_init__(self) -> None:
        expected = {
            name
            for name, parameter in inspect.signature(self.function).parameters.items()
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY
        }
        if not isinstance(self.params, dict | None):
            raise UsageError(
                f"the term {self.function.__name__} has parameters {reprlib.repr(self.params)}; "
                "expected numbers by their names"
            )
        parameters = set(self.params or ())
        if parameters != expected:
            raise UsageError(
                f"the term {self.function.__name__} has parameters {sorted(parameters)}; "
                f"expected {sorted(expected)}"
            )

    def check_numbers(self, name: str) -> None:
        """Raise a `UsageError` for a number out of its bounds; messages call the term `name`."""
        for parameter, value in (self.params or {}).items():
            check_value(f"{name}.{parameter}", value, float)
        for setting in fields(self):
            flag = f"{name}.{setting.name}".removesuffix(".scale")
            check_value(flag, getattr(self, setting.name), setting.type)

    def __call__(self, *inputs: Any) -> Any:
        """Return the function's value for its inputs."""
        return self.compute(f"term {self.function.__name__!r}", *inputs)

    def compute(self, what: str, *inputs: Any) -> Any:
        """Return the function's value for `inputs`.

        Raises `UserError`, which calls the term `what`, if it fails or has a wrong shape.
        """
        file, line = _locate(self.function)
        try:
            value = self.function(*inputs, **(self.params or {}))
        except UserError:
            raise
        except Exception as error:
            reason = f"{type(error).__name__}: {error}".partition("\n")[0]
            line = find_line(file, error) or line
            raise UserError(
                f"{file}, line {line}: the {what} does not give {self.gives}: {reason}"
            ) from error
        is_array = isinstance(value, jax.Array | np.ndarray | np.generic | float | int)
        if not is_array or not self.fits(np.shape(value)):
            kind = (
                f"an array of shape {np.shape(value)}" if is_array else f"a {type(value).__name__}"
            )
            raise UserError(f"{file}, line {line}: the {what} gives {kind}; expected {self.gives}")
        return value

    @staticmethod
    def fits(shape: tuple[int, ...]) -> bool:
        """Return True if values of this shape are right for such a term: a single number."""
        return shape == ()


def _locate(function: Callable[..., Any]) -> tuple[str, int]:
    """Return the file that defines a function, and the line."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    return (code.co_filename, code.co_firstlineno) if code else (repr(function), 0)


@dataclass(frozen=True)
class Reward(Term):
    """A term of the reward: `function(robot, step)` in physical units, times a scale."""

    # reward per unit of the term; 0 leaves it out
    scale: Annotated[float, tyro.conf.arg(name="")] = field(kw_only=True)

    @property
    def in_use(self) -> bool:
        """False for the scale 0, which leaves the term out of programs.

        A scale that is an argument of a program is 0 at one time and not at another.
        """
        return isinstance(self.scale, jax.Array) or self.scale != 0.0


@dataclass(frozen=True)
class Observation(Term):
    """A part of the observation: `function(robot, state)` gives a number or a vector."""

    gives: ClassVar[str] = "a number or a vector"

    # names of its numbers; by default none for one, x y z for three, joints for twelve
    labels: tyro.conf.Suppress[tuple[str, ...]] = field(default=(), kw_only=True)
    # standard deviation of the sensor noise at level 1, in the observation's unit
    noise: NotNegative = field(default=0.0, kw_only=True)
    # of so many earlier control steps too, the newest first
    history: Annotated[int, Bounds(0, 1000)] = field(default=0, kw_only=True)

    @property
    def sensor(self) -> bool:
        """True for a sensor's reading, noisy and maybe late; commands and actions are exact."""
        return self.noise > 0.0

    @staticmethod
    def fits(shape: tuple[int, ...]) -> bool:
        """Return True if values of this shape can be observed: a number or a vector."""
        return len(shape) < 2

    def name_numbers(self, name: str, size: int, joints: tuple[str, ...]) -> tuple[str, ...]:
        """Return a name for each of the `size` numbers of this observation, called `name`.

        `joints` are the names of the robot's 12 joints.
        """
        if size == 1 and not self.labels:
            return (name,)
        default_labels = {3: ("x", "y", "z"), len(joints): joints}
        labels = self.labels or default_labels.get(size, tuple(map(str, range(size))))
        if len(labels) != size:
            raise UsageError(
                f"the observation {name} has {size} numbers and {len(labels)} labels; "
                "expected one for each"
            )
        return tuple(f"{name}_{label}" for label in labels)


@dataclass(frozen=True)
class Termination(Term):
    """A way to fall: `function(robot, step)` is true in the step that ends the episode."""


@dataclass(frozen=True)
class ActionMap(Term):
    """A map of actions: `function(robot, action)` gives joint targets (12,), rad.

    A function of three inputs also gets the joints' angles (12,), rad.
    """

    gives: ClassVar[str] = "12 joint targets"

    def __call__(self, robot: Any, action: Any, joints: Any) -> Any:
        parameters = inspect.signature(self.function).parameters.values()
        positional = [p for p in parameters if p.kind is not inspect.Parameter.KEYWORD_ONLY]
        return super().__call__(robot, action, *([joints] if len(positional) > 2 else []))

    @staticmethod
    def fits(shape: tuple[int, ...]) -> bool:
        """Return True if values of this shape are right for an action map: twelve targets."""
        return shape == (12,)
