from typing import Any

import pytest
from pydantic import ValidationError

from core.clips.options import ClipChoice

FILE = "sha256:" + "0" * 64


def test_only_the_file_has_no_default() -> None:
    choice = ClipChoice(file=FILE)
    assert (choice.names, choice.weight, choice.from_s, choice.to_s, choice.mirror, choice.speed) == (
        None,
        1.0,
        0.0,
        None,
        False,
        1.0,
    )


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"file": "walk.npz"}, "should match pattern"),
        ({"names": ["("]}, "no regular expression"),
        ({"weight": 0.0}, "greater than 0"),
        ({"speed": 100.0}, "less than or equal to 10"),
        ({"from_s": 2.0, "to_s": 2.0}, "to_s = 2 must be greater than from_s = 2"),
    ],
)
def test_a_choice_that_means_nothing_is_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError, match=sentence):
        ClipChoice(**{"file": FILE} | changes)
