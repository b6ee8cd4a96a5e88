"""Which of the requests that schemathesis makes up are sent, and with which keys."""

from itertools import count
from typing import Any

import schemathesis

from api.submissions import EXAMPLE_KEY

_OF_THESE_ONE = 10
_number = count()

schemathesis.serializer.alias("application/zip", "application/octet-stream")


# Of what is made up three in four are for this operation, most of them one option of the wrong type each.
@schemathesis.hook("filter_case").apply_to(path="/jobs", method="POST")
def a_part_of_the_coverage(_: schemathesis.HookContext, case: schemathesis.Case) -> bool:
    is_coverage = case.meta is not None and case.meta.phase.name.value == "coverage"
    return not is_coverage or next(_number) % _OF_THESE_ONE == 0


@schemathesis.hook
def before_call(_: schemathesis.HookContext, case: schemathesis.Case, **__: Any) -> None:
    """An import gets a key of its own: the document's example may have been used for a job by then."""
    if case.operation.label == "POST /jobs/import" and case.headers.get("Idempotency-Key") == EXAMPLE_KEY:
        case.headers["Idempotency-Key"] = f"{EXAMPLE_KEY}-of-an-import"
