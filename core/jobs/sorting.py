"""The columns by which a list of jobs can be sorted."""

import re

from core.documents import Stored
from core.errors import Problem, Rejected
from core.nearest import nearest

# Each with what it is, for the documentation.
COLUMNS = {
    "created": "when it was submitted",
    "started": "when its first attempt began",
    "finished": "when it ended",
    "name": "in any case of its letters",
    "status": "queued, starting, running, cancelling, succeeded, failed, cancelled",
    "kind": "rollout, train",
    "environment": "the environment's id",
    "owner": "a user's name",
    "project": "a project's name",
    "duration": "seconds since its first attempt began, until now or its end",
    "steps": "environment steps that it has done",
    "steps_per_second": "as it last reported them",
    "return": "the last mean return of an evaluation; before the first one, that of training",
    "attempts": "how many there were",
    "device": "of its newest attempt that has one",
    "engine": "of its newest attempt that has one",
}
LABEL = "label:"
_KEY = re.compile(r"[A-Za-z0-9_.-]{1,63}")


class Sort(Stored):
    """The order of a list; what has no value comes last either way. column: one of COLUMNS or `label:KEY`."""

    column: str
    descending: bool = True

    @property
    def label(self) -> str | None:
        """The key of the label that it is by."""
        return self.column.removeprefix(LABEL) if self.column.startswith(LABEL) else None


def sort_by(column: str, *, descending: bool) -> Sort:
    """Raises Rejected for what is no column."""
    found = Sort(column=column, descending=descending)
    if column in COLUMNS or (found.label is not None and _KEY.fullmatch(found.label)):
        return found
    if found.label is not None:
        sentence = "`sort` by a label is `label:` and a key of letters, digits, `_`, `.` and `-`."
    else:
        near = nearest(column.lower(), COLUMNS)
        hint = f"did you mean `{near[0]}`?" if near else f"choose one of {', '.join(COLUMNS)}, or label:KEY."
        sentence = f"There is no column {column[:80]!r} to sort by; {hint}"
    raise Rejected(sentence, [Problem("/sort", sentence)])
