"""The last values of a term, and which of them are seen; for arrays of NumPy, or of JAX."""

from types import ModuleType

import numpy as np

from core.environments.terms.term import Array


def begun(first: Array, length: int, xp: ModuleType) -> Array:
    """The last `length` values [length, n] at an episode's start: all of them the first one [n]."""
    return xp.tile(first, (length, 1))


def remembered(past: Array, newest: Array, xp: ModuleType) -> Array:
    """The last values [length, n] after another one [n]; the oldest comes first."""
    return xp.concatenate([past[1:], newest[None]])


def seen(past: Array, number: int, delay: Array | int = 0) -> Array:
    """`number` values one after the other [number * n], the oldest first; the last is `delay` steps old."""
    return past[len(past) - number - delay + np.arange(number)].ravel()
