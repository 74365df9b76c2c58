"""Which gait it is: strides, duty factors and phases from the feet's contacts alone.

A stride of a foot goes from one touchdown to its next. The phase of another foot is the fraction of
the reference foot's stride after which it touches down (Hildebrand, "Symmetrical gaits of horses",
Science 150, 1965). The gait's name follows from the phases (the same; Hildebrand, "Analysis of
asymmetrical gaits", J. Mammalogy 58, 1977; Alexander, "The gaits of bipedal and quadrupedal
animals", Int. J. Robotics Research 3, 1984).
"""

import itertools
from dataclasses import dataclass

import numpy as np

GAITS = ("walk", "trot", "pace", "bound", "gallop", "pronk", "irregular")

SHORTEST = 0.03  # s: a foot that leaves the ground for less has chattered, and one that touches
# it for less, and less than half as long as it does in its strides, has brushed it in its swing
TOLERANCE = 1 / 8  # of a stride: half the distance between neighboring ideal gaits
REGULAR = 0.7  # least mean resultant length of a foot's phases: they scatter by 0.13 of a stride
FEWEST_STRIDES = 2  # of the reference foot, to speak of a gait

_REFERENCE = 0  # FR


@dataclass(frozen=True)
class Footfalls:
    """How four feet (FR, FL, RR, RL) meet the ground; NaN where there is nothing to measure."""

    gait: str  # one of GAITS
    stride_frequency: float  # Hz, mean over the feet that make strides
    strides: np.ndarray  # (4,) complete strides of each foot
    duty_factor: np.ndarray  # (4,) fraction of its strides that a foot is on the ground
    phase: np.ndarray  # (4,) in [0, 1), touchdown after FR's, in strides; FR's is 0
    regularity: np.ndarray  # (4,) mean resultant length of the phases: 1 always the same, 0 random


def analyze_footfalls(contact: np.ndarray, dt: float) -> Footfalls:
    """The footfalls in `contact` (T, 4), bool, one row every `dt` s, feet FR, FL, RR, RL."""
    contact = without_chatter(contact, dt)
    landings = [touchdowns(contact[:, foot]) for foot in range(4)]
    strides = np.array([max(len(rows) - 1, 0) for rows in landings])
    periods = [(rows[-1] - rows[0]) * dt / (len(rows) - 1) for rows in landings if len(rows) > 1]
    phase, regularity, even = _phases(landings)
    regular = even and strides[_REFERENCE] >= FEWEST_STRIDES and bool(np.all(regularity >= REGULAR))
    return Footfalls(
        gait=name_gait(phase) if regular else "irregular",
        stride_frequency=float(1 / np.mean(periods)) if periods else np.nan,
        strides=strides,
        duty_factor=np.array([_duty(contact[:, k], rows) for k, rows in enumerate(landings)]),
        phase=phase,
        regularity=regularity,
    )


def without_chatter(contact: np.ndarray, dt: float) -> np.ndarray:
    """`contact` (T, 4) without each foot's gaps, then brushes, that are shorter than `SHORTEST`.

    At a gallop of six strides a second every contact is short: a brush is short beside those that
    hold most of the foot's time on the ground. What touches the first or last row stays: its other
    part may be outside.
    """
    cleaned = np.array(contact, dtype=bool)
    longest = int(np.ceil(SHORTEST / dt - 1e-9)) - 1
    for foot in cleaned.T:
        for state in (False, True):
            edges = np.flatnonzero(foot[1:] != foot[:-1]) + 1
            inner = [(a, b) for a, b in itertools.pairwise(edges) if foot[a] == state]
            usual = _usual_length([b - a for a, b in inner]) if state else np.inf
            for start, end in inner:
                if end - start <= longest and end - start < usual / 2:
                    foot[start:end] = not state
    return cleaned


def _usual_length(lengths: list[np.signedinteger]) -> float:
    """The length that half of their sum lies below: their median, each counted by its length."""
    ordered = np.sort(lengths)
    held = np.cumsum(ordered)
    return float(ordered[np.searchsorted(held, held[-1] / 2)]) if len(ordered) else np.inf


def touchdowns(foot: np.ndarray) -> np.ndarray:
    """Rows of `foot` (T,), bool, that begin a contact."""
    return np.flatnonzero(~foot[:-1] & foot[1:]) + 1


def contact_spans(foot: np.ndarray) -> np.ndarray:
    """(n, 2) of `foot` (T,), bool: the first row of each contact, and the first after it."""
    padded = np.concatenate([[0], foot, [0]]).astype(int)
    return np.flatnonzero(np.diff(padded)).reshape(-1, 2)


def name_gait(phase: np.ndarray) -> str:
    """The gait whose touchdowns have these phases (4,), of FR, FL, RR, RL, in strides.

    Feet of a pair (fore, hind) touch down together, alternate, or are split between those.
    Both pairs alternate: the lag of a fore foot behind the hind foot of its side tells a pace
    (none), a trot (half a stride) and a walk (a quarter, either way; with duty factors under one
    half it is the running form of it, an amble). Both pairs together: a pronk if all four are,
    else a bound. At least one pair split and none alternating: a gallop, of which a split pair
    with a pair together is the half-bound.
    """
    if not np.all(np.isfinite(phase)):
        return "irregular"
    fr, fl, rr, rl = phase
    fore, hind = circular_distance(fr, fl), circular_distance(rr, rl)
    alternate = [lag > 0.5 - TOLERANCE for lag in (fore, hind)]
    together = [lag < TOLERANCE for lag in (fore, hind)]
    if all(alternate):
        lag = circular_mean(np.array([fr - rr, fl - rl]))[0]
        if circular_distance(lag, 0.0) < TOLERANCE:
            return "pace"
        return "trot" if circular_distance(lag, 0.5) < TOLERANCE else "walk"
    if any(alternate):
        return "irregular"
    if all(together):
        lag = circular_distance(
            circular_mean(np.array([fr, fl]))[0], circular_mean(np.array([rr, rl]))[0]
        )
        return "pronk" if lag < TOLERANCE else "bound"
    return "gallop"


def circular_distance(a: float, b: float) -> float:
    """How far two phases are apart, in [0, 0.5] strides."""
    return float(abs((a - b + 0.5) % 1.0 - 0.5))


def circular_mean(phases: np.ndarray) -> tuple[float, float]:
    """Mean direction in [0, 1) and mean resultant length in [0, 1] of phases in strides.

    Mardia & Jupp, "Directional Statistics", 2000, section 2.2. NaN, 0 of no phases.
    """
    if len(phases) == 0:
        return np.nan, 0.0
    mean = np.mean(np.exp(2j * np.pi * np.asarray(phases)))
    direction = float(np.angle(mean) / (2 * np.pi)) % 1.0
    return direction % 1.0, float(abs(mean))  # a second time: -1e-17 % 1 is 1


def _phases(landings: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, bool]:
    """Phase and regularity (4,) of each foot, and whether all feet make as many strides."""
    reference = landings[_REFERENCE]
    phase, regularity = np.full(4, np.nan), np.zeros(4)
    if len(reference) < 2:
        return phase, regularity, False
    even = True
    for foot, rows in enumerate(landings):
        rows = rows[(rows >= reference[0]) & (rows < reference[-1])]
        stride = np.searchsorted(reference, rows, side="right") - 1
        start, end = reference[stride], reference[stride + 1]
        phase[foot], regularity[foot] = circular_mean((rows - start) / (end - start))
        # A foot that lands twice as often, or every other time, is not in this gait.
        even &= abs(len(rows) - (len(reference) - 1)) <= max(1, 0.2 * (len(reference) - 1))
    return phase, regularity, bool(even)


def _duty(foot: np.ndarray, landings: np.ndarray) -> float:
    """Fraction on the ground over whole strides; over everything where there is none."""
    if len(landings) > 1:
        foot = foot[landings[0] : landings[-1]]
    return float(foot.mean()) if len(foot) else np.nan
