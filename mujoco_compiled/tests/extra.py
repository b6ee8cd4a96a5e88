"""Parameters with which a test is more of the same."""

from typing import Any

import pytest


def extra(*cases: Any) -> list[Any]:
    """The cases, marked `extra`; a tuple is one of several parameters."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.extra)
        for case in cases
    ]
