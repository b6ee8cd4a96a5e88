"""A job's metrics, as JSON or CSV."""

import csv
import io
from collections.abc import Sequence
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from api.dependencies import EntryId, JobId, Parameters, ServiceDep
from api.problems import refusals
from api.views import Metrics, MetricsRow
from core.errors import JobNotFound, RecordsUnavailable, Rejected, StorageUnavailable
from core.jobs.store import Entry, entry_number

router = APIRouter(tags=["jobs"])

_EXAMPLE = "step,time,eval/episode_reward\r\n0,2026-11-20T09:00:00+00:00,1.0\r\n"


class Measured(Parameters):
    """The rows to return, and their format."""

    after: EntryId = Field("", description="Only rows after this `next` of an earlier answer.")
    limit: int = Field(10_000, ge=1, le=100_000)
    format: Literal["json", "csv"] | None = Field(
        None, description="Takes precedence over the header Accept."
    )


@router.get(
    "/jobs/{job_id}/metrics",
    response_model=Metrics,
    responses={
        200: {"content": {"text/csv": {"example": _EXAMPLE}}},
        **refusals(JobNotFound, Rejected, RecordsUnavailable, StorageUnavailable),
    },
)
def read_metrics(
    job_id: JobId, asked: Annotated[Measured, Query()], service: ServiceDep, request: Request
) -> Metrics | Response:
    """Metrics, at most `limit` rows; where a later attempt measured a step again, its newer values."""
    entries = service.read_feed(
        job_id, "events", after=entry_number(asked.after), kind="metrics", limit=asked.limit
    )
    rows = _newest([MetricsRow(**entry.data, time=entry.time) for entry in entries])
    wants_csv = asked.format == "csv" or (
        asked.format is None and _prefers_csv(request.headers.get("accept", ""))
    )
    if wants_csv:
        return Response(table(rows), media_type="text/csv; charset=utf-8", headers=_attachment(job_id))
    return Metrics(rows=rows, next=_last_id(entries) or asked.after or None)


def table(rows: Sequence[MetricsRow]) -> str:
    """Rows as CSV (RFC 4180): step, time, then every name in alphabetical order; empty for no value."""
    names = sorted({name for row in rows for name in row.values})
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["step", "time", *names])
    for row in rows:
        writer.writerow([row.step, row.time.isoformat(), *(row.values.get(name) for name in names)])
    return text.getvalue()


def _newest(rows: Sequence[MetricsRow]) -> list[MetricsRow]:
    found: dict[tuple[int, frozenset[str]], MetricsRow] = {}
    for row in rows:
        identity = (row.step, frozenset(row.values))
        found.pop(identity, None)
        found[identity] = row
    return list(found.values())


def _last_id(entries: Sequence[Entry]) -> str | None:
    return entries[-1].id if entries else None


def _prefers_csv(accept: str) -> bool:
    types = [part.partition(";")[0].strip().lower() for part in accept.split(",")]
    return "text/csv" in types and "application/json" not in types[: types.index("text/csv")]


def _attachment(job_id: str) -> dict[str, str]:
    return {
        "Content-Disposition": f'inline; filename="{job_id}-metrics.csv"',
        "X-Content-Type-Options": "nosniff",
    }
