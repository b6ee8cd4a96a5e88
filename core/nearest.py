"""Names that are like a wrong one, found in a bounded time."""

import difflib
from collections.abc import Iterable
from itertools import islice

# A comparison takes some 50 microseconds.
_MOST_COMPARED = 1000
_LONGEST = 60


def nearest(wrong: str, known: Iterable[str], *, number: int = 1, cutoff: float = 0.6) -> list[str]:
    """The names most like this one, best first; of very many or long names, some are not looked at."""
    short = (name for name in islice(known, _MOST_COMPARED) if len(name) <= 2 * _LONGEST)
    return difflib.get_close_matches(wrong[:_LONGEST], list(short), n=number, cutoff=cutoff)
