"""In which order the files of tests are run: those that mostly wait beside those that mostly compute."""

from itertools import groupby

import pytest

# Their tests start processes, and wait for them and for one another.
_WAITING = ("tests/e2e/", "tests/faults/")
# The rest of a run is for files that are over soon: no process of it works alone at the end.
_UNTIL = 0.9


def spread(items: list[pytest.Item]) -> list[pytest.Item]:
    """The same tests, the files that wait spread evenly over the others; each kind stays in its order."""
    files = [list(tests) for _, tests in groupby(items, key=_file)]
    waiting = [tests for tests in files if _file(tests[0]).startswith(_WAITING)]
    computing = [tests for tests in files if not _file(tests[0]).startswith(_WAITING)]
    places = [
        *((number / len(waiting) * _UNTIL, tests) for number, tests in enumerate(waiting)),
        *((number / len(computing), tests) for number, tests in enumerate(computing)),
    ]
    return [test for _, tests in sorted(places, key=lambda place: place[0]) for test in tests]


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]
