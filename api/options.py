"""An environment's options in a query: a JSON object."""

from pydantic import JsonValue, TypeAdapter, ValidationError

from core.environments import catalog
from core.environments.info import EnvironmentInfo
from core.errors import Problem, Rejected
from core.jobs.resolved import resolve_environment
from core.jobs.spec import EnvironmentSpec
from core.user_models.store import ModelStore

OPTIONS_DESCRIPTION = "The environment's options, as a JSON object."
# A character takes up to 12 in an address, and the server takes addresses of 64 KiB.
MAX_OPTIONS_LENGTH = 5_000
_OPTIONS: TypeAdapter[dict[str, JsonValue]] = TypeAdapter(dict[str, JsonValue])


def parse_options(text: str) -> dict[str, JsonValue]:
    """Raises Rejected unless the text is a JSON object."""
    try:
        return _OPTIONS.validate_json(text)
    except ValidationError:
        detail = "`options` is not a JSON object."
        raise Rejected(detail, [Problem("/options", detail)]) from None


def in_the_query(refusal: Rejected) -> Rejected:
    """A job's refusal with its pointers turned into names of query parameters."""
    problems = [
        Problem(problem.pointer.removeprefix("/environment").removeprefix("/video"), problem.detail)
        for problem in refusal.problems
    ]
    return Rejected(refusal.detail, problems, **refusal.facts)


def info_under(environment_id: str, options: str | None, store: ModelStore) -> EnvironmentInfo:
    """The environment's row of the catalog under these options; without any, the row itself.

    Raises EnvironmentNotFound, and Rejected with the same messages as for a job.
    """
    info = catalog.find(environment_id)
    if options is None:
        return info
    environment = EnvironmentSpec(id=environment_id, options=parse_options(options))
    try:
        return resolve_environment(environment, store)[0]
    except Rejected as refusal:
        raise in_the_query(refusal) from None
