"""Doubles that compress well."""

import numpy as np

MANTISSA_BITS = 19  # kept, of a double's 52
RELATIVE_ERROR = 2.0 ** -(MANTISSA_BITS + 1)  # at most: a millionth

_DROPPED = 52 - MANTISSA_BITS
_HALF = np.uint64(1 << (_DROPPED - 1))
_KEPT = np.uint64((1 << 64) - (1 << _DROPPED))


def compact(array: np.ndarray) -> np.ndarray:
    """`array` as doubles rounded to `MANTISSA_BITS`, to within a millionth of each value.

    Their lower four bytes are zero, which costs next to nothing in a compressed file, where the
    full mantissa of a simulated number is noise that no compressor can shorten.
    """
    bits = np.array(array, dtype=np.float64, order="C").view(np.uint64)
    return ((bits + _HALF) & _KEPT).view(np.float64)
