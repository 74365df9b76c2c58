"""The values that settings may have: they stand with the types and are checked at creation."""

import reprlib
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin

from quadwalk.errors import UsageError

_MOST = 1e12  # of a number that states no bound; float32 holds it


@dataclass(frozen=True)
class Bounds:
    """The interval from `low` to `high`, without the end that is `open`.

    Several `ordered` numbers ascend.
    """

    low: float = -_MOST
    high: float = _MOST
    open: Literal["low", "high"] | None = None
    unit: str = ""
    ordered: bool = False

    @property
    def ends(self) -> tuple[float | None, float | None]:
        """The lower and the upper end; None where there is none."""
        return (
            None if self.low <= -_MOST else self.low,
            None if self.high >= _MOST else self.high,
        )

    def holds(self, number: Any) -> bool:
        """Return True if `number` is from `low` to `high`, without the `open` end; NaN is not."""
        if isinstance(number, bool) or not isinstance(number, int | float):
            return False
        above = self.low < number if self.open == "low" else self.low <= number
        return above and (number < self.high if self.open == "high" else number <= self.high)

    def __str__(self) -> str:
        low, high = (f"{end:.12g} {self.unit}".strip() for end in (self.low, self.high))
        if self.low <= -_MOST:
            return "a finite number"
        if self.high >= _MOST:
            return f"more than {low}" if self.open == "low" else f"{low} or more"
        if self.open == "low":
            return f"more than {self.low:.12g}, up to {high}"
        return f"{self.low:.12g} to {'less than ' * (self.open == 'high')}{high}"


Positive = Annotated[float, Bounds(0.0, open="low")]
Seconds = Annotated[float, Bounds(0.0, 86400.0, open="low", unit="s")]
NotNegative = Annotated[float, Bounds(0.0)]
Share = Annotated[float, Bounds(0.0, 1.0)]
Natural = Annotated[int, Bounds(0)]
Count = Annotated[int, Bounds(1)]
Few = Annotated[int, Bounds(1, 1000)]
Seed = Annotated[int, Bounds(0, 2**32 - 1)]
Port = Annotated[int, Bounds(0, 65535)]


class Settings:
    """A dataclass whose numbers and choices are checked; its flags begin with `group`."""

    group: ClassVar[str] = ""

    def __init_subclass__(cls, group: str = "", **others: Any) -> None:
        super().__init_subclass__(**others)
        cls.group = group

    def __post_init__(self) -> None:
        config: Any = self
        for field in fields(config):
            name = f"{self.group}.{field.name}".removeprefix(".")
            check_value(name, getattr(self, field.name), field.type)


def check_value(name: str, value: Any, hint: Any) -> None:
    """Raise a `UsageError` unless the setting `name`, of type `hint`, may be `value`.

    It checks choices, numbers, and tuples of numbers.
    """
    parts = _list_parts(hint)
    if value is None and type(None) in parts:
        return
    if get_origin(hint) is Literal:
        fits, expected = value in get_args(hint), " or ".join(get_args(hint))
    elif int in parts or float in parts:
        fits, expected = _check_numbers(value, parts)
    else:
        return
    if not fits:
        flag = f"--{name.replace('_', '-')}"
        raise UsageError(f"{flag} is {reprlib.repr(value)}; expected {expected}")


def find_bounds(hint: Any) -> Bounds:
    """Return the bounds that a type states; without any, those of all finite numbers."""
    return next((part for part in _list_parts(hint) if isinstance(part, Bounds)), Bounds())


def _check_numbers(value: Any, parts: list[Any]) -> tuple[bool, str]:
    """Return True if a value fits the type with these parts, and what the type expects."""
    bounds = find_bounds(parts[0])
    several = next((get_args(part) for part in parts if get_origin(part) is tuple), None)
    numbers = (value,) if several is None else value if isinstance(value, tuple) else ()
    broken = int in parts and any(isinstance(number, float) for number in numbers)
    fits = bool(numbers) and not broken and all(map(bounds.holds, numbers))
    expected = f"{'a whole number, ' * broken}{bounds}"
    largest = max((x for x in numbers if isinstance(x, int | float)), default=0.0)
    if largest > bounds.high >= _MOST:  # which `bounds` alone does not say
        expected = f"at most {bounds.high:.12g} {bounds.unit}".strip()
    if several is not None:
        count = "" if Ellipsis in several else f"{len(several)} "
        fits = fits and (not count or len(numbers) == len(several))
        expected = f"{count}numbers, each {expected}"
        if bounds.ordered:
            fits = fits and list(numbers) == sorted(numbers)
            expected += ", the lower first"
    return fits, f"{expected}, or None" if type(None) in parts else expected


def _list_parts(hint: Any) -> list[Any]:
    """Return a type hint, followed by all types and annotations nested in it."""
    return [hint, *(part for inner in get_args(hint) for part in _list_parts(inner))]
