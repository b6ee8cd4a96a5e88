"""Answers of the last moments, for clients that say that they take one which is not quite new."""

import re
import time
from collections import OrderedDict
from threading import Lock

_MAX_AGE = re.compile(r"\bmax-age=(\d{1,3})\b")
_MAX_ANSWERS = 64


def max_age_s(cache_control: str) -> float:
    """The age that the header `Cache-Control` of a request allows; 0 if it says nothing."""
    found = _MAX_AGE.search(cache_control)
    return float(found[1]) if found else 0.0


class RecentAnswers:
    """The newest answer to each of the questions that were asked last."""

    def __init__(self) -> None:
        self._answers = OrderedDict[str, tuple[float, bytes]]()
        self._lock = Lock()

    def find(self, question: str, max_age_s: float) -> bytes | None:
        """An answer of at most this age, or None."""
        with self._lock:
            since, answer = self._answers.get(question, (0.0, b""))
        return answer if answer and time.monotonic() - since <= max_age_s else None

    def keep(self, question: str, answer: bytes) -> None:
        with self._lock:
            self._answers[question] = (time.monotonic(), answer)
            self._answers.move_to_end(question)
            if len(self._answers) > _MAX_ANSWERS:
                self._answers.popitem(last=False)
