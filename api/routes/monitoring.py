"""Metrics for Prometheus, and what projects and devices were used for."""

from dataclasses import replace
from datetime import datetime, timedelta
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request, Response
from pydantic import AwareDatetime, BeforeValidator, Field

from api.access import PrincipalDep
from api.dependencies import QueryParameters, ServiceDep
from api.monitoring import exposition
from api.problems import refusals
from api.views import answer
from core.errors import Problem, RecordsUnavailable, Rejected
from gaitway.schema import UsageView

router = APIRouter(tags=["monitoring"])

_EXAMPLE = '# TYPE gaitway_jobs gauge\ngaitway_jobs{status="running",project="default"} 2.0\n'
_TEXT: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/plain": {"schema": {"type": "string"}, "example": _EXAMPLE}}}
}


@router.get("/metrics", response_class=Response, responses=_TEXT)
def show_metrics(
    request: Request, service: ServiceDep, accept: Annotated[str, Header(max_length=1000)] = ""
) -> Response:
    """The service's metrics for Prometheus, as text or, where `Accept` asks for that, as OpenMetrics.

    The numbers of the record may be five seconds old. While PostgreSQL is unavailable, `gaitway_record_up` is
    0 and they are missing.
    """
    body, media_type = exposition(request.app.state.instruments, service.recent, accept)
    return Response(body, headers={"Content-Type": media_type})


def _no_number(text: str) -> str:
    """Refuse what pydantic would read as seconds since 1970, and the document does not offer."""
    try:
        float(text)
    except ValueError:
        return text
    raise ValueError("give a date and a time with a time zone, such as 2026-11-20T09:00:00Z")


class UsageWindow(QueryParameters):
    """From when on."""

    since: Annotated[AwareDatetime, BeforeValidator(_no_number)] | None = Field(
        None,
        description="The beginning, with a time zone; rounded down to the hour. By default a day ago.",
        examples=["2026-11-20T09:00:00Z"],
    )


@router.get("/usage", response_model=UsageView, responses=refusals(Rejected, RecordsUnavailable))
def read_usage(
    window: Annotated[UsageWindow, Query()], service: ServiceDep, principal: PrincipalDep
) -> Response:
    """What was used since then, by project and user, and how busy each device was in the last day.

    Attempts that run now are counted up to now. What deleted jobs have used stays counted. With accounts, the
    projects are those that one sees.
    """
    now = service.store.now()
    since = window.since or now - timedelta(days=1)
    _check(since, now)
    usage = service.store.usage(since)
    seen = [used for used in usage.projects if principal.sees(used.project)]
    return answer(UsageView.model_validate(replace(usage, projects=seen)))


def _check(since: datetime, now: datetime) -> None:
    """Raises Rejected."""
    if since > now:
        detail = f"`since` is {since.isoformat()}, which is in the future; it is {now.isoformat()} now."
        raise Rejected(detail, [Problem("/since", detail)])
