"""The ledger, the sums of what workers count, and the numbers of the record for monitoring."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import (
    Connection,
    Double,
    Text,
    and_,
    bindparam,
    case,
    cast,
    delete,
    func,
    literal,
    literal_column,
    or_,
    select,
    text,
    true,
    tuple_,
    union_all,
    update,
)
from sqlalchemy.dialects.postgresql import JSONB, insert

from core.adapters.postgres.engine import Session
from core.adapters.postgres.rows import HELD, Values, age_s, columns
from core.adapters.postgres.tables import (
    NOW,
    UNFINISHED,
    attempts,
    jobs,
    pulse,
    shares,
    tallies,
    usage,
)
from core.adapters.postgres.uploads import TABLES as UPLOADS
from core.jobs.job import Job
from core.jobs.pools import GIVEN
from core.jobs.slots import kind_of_queue
from core.jobs.status import JobStatus
from core.jobs.tallies import Tally
from core.jobs.usage import (
    DEVICES_KEPT,
    DEVICES_SHOWN,
    HOUR,
    Ended,
    ProjectUsage,
    RecordNumbers,
    RunningAttempt,
    UnfinishedJobs,
    Usage,
    beginning_of_hour,
    entries,
    usage_of,
)

# Parameters of statements about one project and one owner; see `concerning`.
PROJECT, OWNER = bindparam("project", type_=Text), bindparam("owner", type_=Text)
_KEY = tuple(column.name for column in usage.primary_key)
_SUMS = ("jobs", "attempts", "seconds", "gpu_seconds")
# How many entries of one hour, whose hosts are forgotten, are merged at a time.
_FOLDED_AT_ONCE = 20_000

_KIND = case((usage.c.device == "", ""), (usage.c.device.like("gpu%"), "gpu"), else_="cpu")


def added_to_ledger(statement: Any) -> Any:
    """An insertion that adds to the entries that are there."""
    added = {name: usage.c[name] + statement.excluded[name] for name in _SUMS}
    return statement.on_conflict_do_update(index_elements=_KEY, set_=added)


_SUMMED = [func.sum(usage.c[name]).label(name) for name in _SUMS]
_ENDED = select(usage.c.project, usage.c.status, usage.c.reason, _KIND.label("device"), *_SUMMED).group_by(
    usage.c.project, usage.c.status, usage.c.reason, _KIND
)
_USED = (
    select(usage.c.project, usage.c.owner, *_SUMMED)
    .where(usage.c.hour >= bindparam("since"))
    .group_by(usage.c.project, usage.c.owner)
)
_BUSY = (
    select(usage.c.host, usage.c.device, usage.c.hour, func.sum(usage.c.seconds).label("seconds"))
    .where(usage.c.hour >= bindparam("since"), usage.c.device != "", usage.c.host != "")
    .group_by(usage.c.host, usage.c.device, usage.c.hour)
    .order_by(usage.c.host, usage.c.device)
)
_UNFINISHED = (
    select(jobs.c.project, jobs.c.status, func.count().label("number"))
    .where(jobs.c.status.in_(UNFINISHED))
    .group_by(jobs.c.project, jobs.c.status)
)
_RUNNING = (
    select(
        jobs.c.project,
        jobs.c.owner,
        jobs.c.queue,
        attempts.c.worker,
        attempts.c.started_at,
        func.coalesce(attempts.c.gpu_part, 1.0).label("part"),
        func.coalesce(cast(attempts.c.details, JSONB)[GIVEN].astext, "").label("given"),
    )
    .join(jobs, and_(jobs.c.id == attempts.c.job_id, jobs.c.num_attempts == attempts.c.number))
    .where(jobs.c.status.in_(HELD))
)
_QUEUED = (
    select(
        jobs.c.project,
        func.coalesce(jobs.c.owner, "").label("owner"),
        func.count().label("number"),
        age_s(func.min(jobs.c.created_at)).label("oldest_s"),
    )
    .where(jobs.c.status == "queued")
    .group_by(jobs.c.project, jobs.c.owner)
)
_MOMENT = select(NOW.label("moment"), pulse.c.beat_at).select_from(
    select(literal(1).label("one")).subquery().outerjoin(pulse, true())
)


# Bucket by bucket.
_TALLY = text(
    """
    INSERT INTO tallies (series, labels, buckets, total) VALUES (:series, :labels, :buckets, :total)
    ON CONFLICT (series, labels) DO UPDATE SET
        total = tallies.total + excluded.total,
        buckets = ARRAY(
            SELECT coalesce(before, 0) + coalesce(more, 0)
            FROM unnest(tallies.buckets, excluded.buckets) WITH ORDINALITY AS pairs (before, more, place)
            ORDER BY place
        )
    """
)


# What was there is halved by the time since; PostgreSQL refuses a power too small for its numbers. With exact
# numbers it takes ten times as long.
_LEFT = """
    power(0.5::float, least(100, greatest(0, CAST(extract(epoch FROM clock_timestamp() - shares.at) AS float)
        / CAST(extract(epoch FROM coalesce((SELECT half_life FROM pulse), interval '3 days')) AS float))))
"""
# By the half-life that was true until now.
_BRING_UP_TO_DATE = text(f"""
    UPDATE shares SET amount = amount * {_LEFT}, attempts = attempts * {_LEFT}, seconds = seconds * {_LEFT},
        at = clock_timestamp()
""")  # noqa: S608 # A constant.
SHARES = f"""
    SELECT device, project, owner, amount * {_LEFT} AS amount, seconds / attempts AS usual_s FROM shares
"""  # noqa: S608 # A constant.


def added_to_shares(statement: Any) -> Any:
    """An insertion that adds to what is left of the shares that are there."""
    left, more = literal_column(_LEFT, Double), statement.excluded
    sums = {name: shares.c[name] * left + more[name] for name in ("amount", "attempts", "seconds")}
    return statement.on_conflict_do_update(
        index_elements=["device", "project", "owner"], set_={**sums, "at": more.at}
    )


def of_change(job: Job, before: JobStatus) -> tuple[Sequence[Values], Sequence[Values]]:
    """What a change of the job's status adds to the ledger, and to the shares.

    before: its status until then.
    """
    new = entries(job, before)
    used = [asdict(entry) for entry in new]
    if not any(entry.attempts for entry in new):
        return used, []
    seconds, gpu_seconds = sum(entry.seconds for entry in new), sum(entry.gpu_seconds for entry in new)
    charged = {
        "device": "gpu" if gpu_seconds else "cpu",
        "project": new[-1].project,
        "owner": new[-1].owner,
        "amount": gpu_seconds or seconds * job.spec.resources.hosts,
        "attempts": 1,
        "seconds": seconds,
    }
    return used, [charged]


def fold(connection: Connection) -> None:
    """Merge the old entries of all hosts."""
    old = tuple_(*(usage.c[name] for name in _KEY)).in_(
        select(*(usage.c[name] for name in _KEY))
        .where(usage.c.hour < NOW - DEVICES_KEPT, usage.c.host != "")
        .limit(_FOLDED_AT_ONCE)
    )
    gone = delete(usage).where(old).returning(*usage.c).cte("gone")
    kind = case((gone.c.device == "", ""), (gone.c.device.like("gpu%"), "gpu"), else_="cpu")
    kept = [gone.c.hour, gone.c.project, gone.c.owner, literal(""), kind, gone.c.status, gone.c.reason]
    merged = select(*kept, *(func.sum(gone.c[name]) for name in _SUMS)).group_by(*kept)
    connection.execute(added_to_ledger(insert(usage).from_select([*_KEY, *_SUMS], merged)))


class UsageQueries(Session):
    """A UsageStore."""

    def numbers(self) -> RecordNumbers:
        with self._statements() as connection:
            moment = connection.execute(_MOMENT).one()
            unfinished = connection.execute(_UNFINISHED).all()
            running = running_attempts(connection)
            ended = connection.execute(_ENDED).all()
            counted = connection.execute(select(tallies)).all()
        return RecordNumbers(
            moment=moment.moment,
            beat_at=moment.beat_at,
            unfinished=[UnfinishedJobs(row.project, row.status, row.number) for row in unfinished],
            running=running,
            ended=[Ended(**columns(row)) for row in ended],
            tallies=[Tally(row.series, tuple(row.labels), tuple(row.buckets), row.total) for row in counted],
        )

    def usage(self, since: datetime) -> Usage:
        since = beginning_of_hour(since)
        with self._statements() as connection:
            now = connection.execute(select(NOW)).scalar_one()
            day = beginning_of_hour(now - DEVICES_SHOWN + HOUR)
            used = connection.execute(_USED, {"since": since}).all()
            busy = connection.execute(_BUSY, {"since": day}).all()
            running = running_attempts(connection)
            queued = connection.execute(_QUEUED).all()
            stored = stored_bytes(connection)
        devices: dict[tuple[str, str], dict[datetime, float]] = defaultdict(dict)
        for row in busy:
            devices[row.host, row.device][row.hour] = row.seconds
        ended = {(row.project, row.owner): ProjectUsage(**columns(row)) for row in used}
        for row in queued:
            used_by = ended.get(who := (row.project, row.owner), ProjectUsage(*who))
            ended[who] = replace(used_by, queued=row.number, oldest_queued_s=row.oldest_s)
        for row in stored:
            used_by = ended.get(who := (row.project, row.owner), ProjectUsage(*who))
            ended[who] = replace(used_by, bytes=row.bytes)
        return usage_of(ended, devices, running, since=since, day=day, until=now)

    def set_half_life(self, span: timedelta) -> None:
        known = select(pulse.c.half_life).with_for_update()
        with self._transaction() as connection:
            if connection.execute(known).scalar() == span:
                return
            connection.execute(_BRING_UP_TO_DATE)
            connection.execute(update(pulse).values(half_life=span))

    def add_tallies(self, tallies: Sequence[Tally]) -> None:
        if not tallies:
            return
        # In one order, so that two processes never wait for each other.
        said = [asdict(tally) for tally in sorted(tallies, key=lambda tally: (tally.series, tally.labels))]
        rows = [{**row, "labels": list(row["labels"]), "buckets": list(row["buckets"])} for row in said]
        with self._transaction() as connection:
            connection.execute(_TALLY, rows)


def running_attempts(connection: Connection) -> list[RunningAttempt]:
    """Those that hold a job now."""
    return [
        RunningAttempt(
            row.project,
            row.owner or "",
            row.worker,
            row.started_at,
            kind_of_queue(row.queue).hosts,
            row.given,
            row.part,
        )
        for row in connection.execute(_RUNNING)
    ]


def stored_bytes(connection: Connection, who: Mapping[str, Any] | None = None) -> Sequence[Any]:
    """The bytes of jobs' files, of models and of clip files, by `project` and `owner`.

    who: as for `concerning`.

    A job's row has the sum over its files, so that no row of a file is read.
    """
    files = select(jobs.c.project, jobs.c.owner, jobs.c.bytes).where(jobs.c.bytes > 0, *concerning(jobs, who))
    sent = (
        select(one.projects.c.project, one.projects.c.owner, one.uploads.c.size.label("bytes"))
        .join(one.uploads, one.uploads.c.id == one.upload)
        .where(*concerning(one.projects, who))
        for one in UPLOADS.values()
    )
    found = union_all(files, *sent).subquery()
    owner = func.coalesce(found.c.owner, "").label("owner")
    wanted = select(found.c.project, owner, func.sum(found.c.bytes).label("bytes"))
    return connection.execute(wanted.group_by(found.c.project, owner), who or {}).all()


def concerning(table: Any, who: Mapping[str, Any] | None) -> Sequence[Any]:
    """The condition for rows of either the project or the owner that the parameters name; none without."""
    return [or_(table.c.project == PROJECT, table.c.owner == OWNER)] if who else []
