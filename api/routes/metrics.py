"""A job's metrics, as JSON or CSV."""

from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from starlette.responses import StreamingResponse

from api.curves import MOST_VALUES, csv_lines, metrics_rows, thinned
from api.dependencies import EntryId, JobId, QueryParameters, Service, ServiceDep
from api.problems import refusals
from api.views import answer
from core.errors import JobNotFound, Problem, RecordsUnavailable, Rejected, StorageUnavailable
from core.jobs import feeds
from core.jobs.metrics import Block, Newest
from core.jobs.spec import Text
from core.jobs.store import entry_number
from gaitway.schema import Metrics

router = APIRouter(tags=["jobs"])

_MAX_ROWS_AS_JSON = 10_000
# A row's step, its time and the row itself take as much time and memory.
_VALUES_OF_A_ROW = 7
_EXAMPLE = "step,time,eval/episode_reward\r\n0,2026-11-20T09:00:00+00:00,1.0\r\n"
_CSV: dict[str, Any] = {
    "content": {"text/csv": {"schema": {"type": "string"}, "example": _EXAMPLE}},
    "headers": {
        "Link": {
            "description": 'With `rel="next"`, the address of the next rows of a CSV that `limit` cut.',
            "schema": {"type": "string"},
        }
    },
}


class MetricsQuery(QueryParameters):
    """The rows to return, and their format."""

    after: EntryId = Field("", description="Only rows after this `next` of an earlier answer.")
    limit: int | None = Field(
        None,
        ge=1,
        le=100_000,
        description=f"The most rows of one answer. By default {_MAX_ROWS_AS_JSON} as JSON, where `next` "
        "leads to the others, and all of them as CSV; fewer where they have more than "
        f"{MOST_VALUES:,} values, as seven of which each row counts.",
    )
    format: Literal["json", "csv"] | None = Field(
        None, description="Takes precedence over the header Accept."
    )
    points: int | None = Field(
        None,
        ge=4,
        le=10_000,
        description="For pictures: at most this many values of each metric, as JSON. The first, the last, "
        "and the least and the greatest of each part between them are kept (min-max); fewer where "
        f"there would be more than {MOST_VALUES:,} values in all. Unlike without it, a row "
        "then has only values that were kept, and an attempt that began again at a checkpoint replaces "
        "all that followed there. `next` is still the feed's end.",
    )
    metric: list[Text] = Field(
        [], max_length=100, description="With `points`: only these metrics; repeatable.", examples=[[]]
    )
    first_step: int | None = Field(None, ge=0, le=10**18, description="With `points`: only from this step.")
    last_step: int | None = Field(None, ge=0, le=10**18, description="With `points`: only up to this step.")

    @property
    def names(self) -> frozenset[str] | None:
        return frozenset(self.metric) or None

    def check(self) -> None:
        """Refuse what would have no effect. Raises Rejected."""
        needing = (
            {"metric", "first_step", "last_step"} if self.points is None else {"after", "limit", "format"}
        )
        if wrong := sorted(needing & self.model_fields_set):
            rule = "needs `points`" if self.points is None else "does not go with `points`"
            problems = [Problem(f"/{name}", f"`{name}` {rule}.") for name in wrong]
            raise Rejected(" ".join(problem.detail for problem in problems), problems)


@router.get(
    "/jobs/{job_id}/metrics",
    response_model=Metrics,
    responses={200: _CSV, **refusals(JobNotFound, Rejected, RecordsUnavailable, StorageUnavailable)},
)
def read_metrics(
    job_id: JobId, asked: Annotated[MetricsQuery, Query()], service: ServiceDep, request: Request
) -> Response:
    """All metrics of a job. Of a step that several attempts measured, the newest values.

    JSON comes in pages. CSV has every row, unless `limit` is given. With `points`, JSON has all steps at
    once, thinned for a picture.
    """
    asked.check()
    if asked.points is not None:
        return _thinned(job_id, asked, asked.points, service)
    wants_csv = asked.format == "csv" or (
        asked.format is None and _prefers_csv(request.headers.get("accept", ""))
    )
    after = entry_number(asked.after)
    if wants_csv:
        if asked.limit is None:
            return _whole_table(job_id, after, service)
        return _part_of_table(job_id, after, asked.limit, service)
    page, _ = _page(job_id, after, asked.limit or _MAX_ROWS_AS_JSON, service)
    rows = metrics_rows(Newest([page]).of(page))
    return answer(Metrics(rows=rows, next=str(page.last) if page.tables else asked.after or None))


def _thinned(job_id: str, asked: MetricsQuery, points: int, service: Service) -> Response:
    curves, last = feeds.read_curves(job_id, store=service.store, objects=service.objects, names=asked.names)
    rows = thinned(curves, points, asked.names, asked.first_step, asked.last_step)
    return answer(Metrics(rows=rows, next=str(last) if last else None))


def _page(job_id: str, after: int, limit: int, service: Service) -> tuple[Block, bool]:
    """At most `limit` rows with at most `MOST_VALUES` values, but one row at least; and whether there are
    more."""
    page, num_rows, num_values = Block(), 0, 0
    for block, _ in feeds.read_metrics(job_id, store=service.store, objects=service.objects, after=after):
        for row in block.rows():
            num_values += _VALUES_OF_A_ROW + len(row.values)
            if num_rows == limit or (num_rows and num_values > MOST_VALUES):
                return page, True
            page.add(row)
            num_rows += 1
    return page, False


def _whole_table(job_id: str, after: int, service: Service) -> Response:
    """Reads the metrics twice: the first line names the columns of all rows, which need not fit in memory."""

    def blocks() -> Iterator[Block]:
        parts = feeds.read_metrics(job_id, store=service.store, objects=service.objects, after=after)
        return (block for block, _ in parts)

    newest = Newest(blocks())  # An error arises here, before the answer begins.
    return _table(job_id, blocks(), newest, {})


def _part_of_table(job_id: str, after: int, limit: int, service: Service) -> Response:
    """At most `limit` rows; the header Link tells where to continue if there are more."""
    page, has_more = _page(job_id, after, limit, service)
    headers = dict[str, str]()
    if has_more:
        query = urlencode({"format": "csv", "after": page.last, "limit": limit})
        headers["Link"] = f'</jobs/{job_id}/metrics?{query}>; rel="next"'
    return _table(job_id, [page], Newest([page]), headers)


def _table(job_id: str, blocks: Iterable[Block], newest: Newest, headers: dict[str, str]) -> Response:
    return StreamingResponse(
        csv_lines(blocks, newest),
        headers={
            "Content-Disposition": f'inline; filename="{job_id}-metrics.csv"',
            "X-Content-Type-Options": "nosniff",
            **headers,
        },
        media_type="text/csv; charset=utf-8",
    )


def _prefers_csv(accept: str) -> bool:
    types = [part.partition(";")[0].strip().lower() for part in accept.split(",")]
    return "text/csv" in types and "application/json" not in types[: types.index("text/csv")]
