"""Quotas: what is used of them, and the refusal of what they do not allow.

The weight and the number of running jobs act where a job is claimed (`core.jobs.turns`), the rest where
something is submitted. The number of queued jobs is exact. GPU-hours and bytes are those of the moment of the
check: what is submitted at the same moment, or waits already, is not counted.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Literal, Protocol

from pydantic import ByteSize

from core.accounts.principal import Ownership
from core.accounts.store import Actor
from core.errors import QuotaExceeded
from core.jobs.queue import PRIORITIES
from core.jobs.spec import JobSpec, Priority
from core.jobs.turns import Quota, Quotas
from core.jobs.usage import HOUR, beginning_of_hour

# GPU-hours are those of this long.
WINDOW = timedelta(days=7)
# Less than this is written as 0.0.
_LEAST_HOURS = 0.05

QuotaKind = Literal["user", "project"]
# What a quota limits where something is submitted, and what is only shown.
Part = Literal["running", "queued", "gpu_hours", "bytes"]
ALL_PARTS: tuple[Part, ...] = ("running", "queued", "gpu_hours", "bytes")


@dataclass(frozen=True, slots=True)
class Use:
    """What the jobs of a user or a project have now.

    gpu_hours: of the last seven days, by the beginning of each hour, with what runs now. bytes: of the files
    of jobs, of models and of clips.
    """

    running: int = 0
    queued: int = 0
    gpu_hours: Mapping[datetime, float] = field(default_factory=dict[datetime, float])
    bytes: int = 0


@dataclass(frozen=True, slots=True)
class QuotaUse:
    """A quota that was set, and what is used of it."""

    kind: QuotaKind
    name: str
    quota: Quota
    use: Use

    @property
    def whose(self) -> str:
        """Such as `project gaits`."""
        return f"{self.kind} {self.name}"


class QuotaStore(Protocol):
    """Part of the record. Every method raises RecordsUnavailable when the store cannot be reached."""

    def quotas(self) -> Quotas:
        """Those that were set."""
        ...

    def quota_uses(
        self, whose: Ownership | None = None, parts: Collection[Part] = ALL_PARTS
    ) -> Sequence[QuotaUse]:
        """The quotas that were set, projects first, with what is used of them.

        whose: only those that a job of this owner and project counts for, and of these only parts with a
        limit. parts: what to read; the rest is 0.
        """
        ...

    def set_quota(self, kind: str, name: str, quota: Quota, actor: Actor) -> None:
        """In place of the one before."""
        ...

    def remove_quota(self, kind: str, name: str, actor: Actor) -> None:
        """Raises QuotaNotFound."""
        ...


def check_quotas(spec: JobSpec, ownership: Ownership, store: QuotaStore, *, with_queue: bool = False) -> None:
    """Before a job or a sweep of such jobs is stored. Raises QuotaExceeded.

    with_queue: whether to count the queued jobs, too, which `JobStore.add` does where it adds one.
    """
    needs_gpu = spec.resources.kind != "cpu"
    parts: list[Part] = ["bytes", *(["gpu_hours"] if needs_gpu else []), *(["queued"] if with_queue else [])]
    for found in store.quota_uses(ownership, parts):
        refuse(over_priority(found, spec.priority))
        if with_queue:
            refuse(over_queue(found))
        if needs_gpu:
            refuse(over_gpu_hours(found))
        refuse(over_bytes(found))


def check_bytes(ownership: Ownership, store: QuotaStore, adding: int = 0) -> None:
    """Before so many bytes are stored. Raises QuotaExceeded."""
    for found in store.quota_uses(ownership, ["bytes"]):
        refuse(over_bytes(found, adding))


def refuse(error: QuotaExceeded | None) -> None:
    """Raises it."""
    if error is not None:
        raise error


def over_priority(found: QuotaUse, priority: Priority) -> QuotaExceeded | None:
    """The refusal of a job of this priority; None if it may have it."""
    highest = found.quota.highest_priority
    if PRIORITIES.index(priority) >= PRIORITIES.index(highest):
        return None
    return QuotaExceeded(
        f"The {found.whose} may submit jobs of the priority {highest} at most, and this one has {priority}: "
        f"set it to {highest}.",
        quota="highest_priority",
        limit=highest,
        used=priority,
    )


def over_queue(found: QuotaUse) -> QuotaExceeded | None:
    """The refusal of one more queued job; None if there is room."""
    most, number = found.quota.queued, found.use.queued
    if most is None or number < most:
        return None
    facts = {"quota": "queued", "limit": most, "used": number}
    if most == 0:
        return QuotaExceeded(f"The {found.whose} may queue nothing: its quota of queued jobs is 0.", **facts)
    jobs = "1 job" if number == 1 else f"{number:,} jobs"
    return QuotaExceeded(
        f"The {found.whose} has {jobs} in the queue, and its quota is {most:,}: one has to start, or to be "
        "cancelled, first.",
        **facts,
    )


def over_gpu_hours(found: QuotaUse) -> QuotaExceeded | None:
    """The refusal of a job that may take GPUs; None if there is room."""
    most, used = found.quota.gpu_hours, sum(found.use.gpu_hours.values())
    if most is None or used < most:
        return None
    facts: dict[str, object] = {"quota": "gpu_hours", "limit": most, "used": round(used, 2)}
    cpu = "A job that asks for a CPU is not held back by it."
    if most == 0:
        detail = f"The {found.whose} may use no GPU: its quota of GPU-hours is 0. {cpu}"
        return QuotaExceeded(detail, **facts)
    moment, free = _next_room(found.use.gpu_hours, most)
    return QuotaExceeded(
        f"The {found.whose} has used {used:,.1f} of {most:,g} GPU-hours in the last seven days; "
        f"{free:,.1f} h free at {moment:%Y-%m-%d %H:%M} UTC, if nothing of it runs until then. {cpu}",
        **facts,
        frees_at=moment,
    )


def _next_room(gpu_hours: Mapping[datetime, float], most: float) -> tuple[datetime, float]:
    """When the first GPU-hours are free if no more are used, and how many. Each hour is forgotten at once."""
    free, hours = most - sum(gpu_hours.values()), sorted(gpu_hours)
    for hour in hours:
        free += gpu_hours[hour]
        if free >= min(most, _LEAST_HOURS):
            return hour + WINDOW, free
    return hours[-1] + WINDOW, most


def over_bytes(found: QuotaUse, adding: int = 0) -> QuotaExceeded | None:
    """The refusal of so many more bytes, or of a job that will store some; None if there is room."""
    most, used = found.quota.bytes, found.use.bytes
    if most is None or (used < most and used + adding <= most):
        return None
    facts = {"quota": "bytes", "limit": most, "used": used}
    if most == 0:
        return QuotaExceeded(f"The {found.whose} may store nothing: its quota of bytes is 0.", **facts)
    more = f", and this is {_size(adding)} more" if used < most else ""
    return QuotaExceeded(
        f"The {found.whose} stores {_size(used)} of its {_size(most)}{more}: delete jobs, models or clips "
        "first, as by `gaitway delete JOB`; that frees room at once.",
        **facts,
    )


def _size(number: int) -> str:
    return ByteSize(number).human_readable(decimal=True, separator=" ")


def first_hour(now: datetime) -> datetime:
    """The oldest hour whose GPU-hours count; each is forgotten seven days after it began."""
    return beginning_of_hour(now - WINDOW) + HOUR
