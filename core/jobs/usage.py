"""The ledger: what each attempt took, hour by hour, for each project, user and device.

An attempt enters it once, in the transaction that ends the attempt. Its entries outlive the job, which may be
deleted.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Protocol

from core.devices import gpu_indices
from core.jobs.job import Job
from core.jobs.pools import GIVEN
from core.jobs.status import JobStatus
from core.jobs.tallies import Tally
from core.jobs.workers import host_and_device

HOUR = timedelta(hours=1)
# Older entries name no device, so that hosts which come and go do not fill the ledger.
DEVICES_KEPT = timedelta(days=8)
# `Usage` names devices for the last day, and no more than these.
DEVICES_SHOWN, MOST_DEVICES = timedelta(days=1), 1000


@dataclass(frozen=True)
class LedgerEntry:
    """An entry of the ledger. hour: its beginning. jobs, attempts: how many ended.

    status: the job's afterwards; `queued` if it waits for another attempt. host, device: the worker's, or the
    GPUs of a pool that it had; empty for a job that ended without an attempt. seconds: of the attempt in this
    hour; gpu_seconds: those, times the GPUs, or the part of one that it shared.
    """

    hour: datetime
    project: str
    owner: str
    host: str
    device: str
    status: str
    reason: str
    jobs: int
    attempts: int
    seconds: float
    gpu_seconds: float


@dataclass(frozen=True)
class Ended:
    """Sums of the ledger over all hours."""

    project: str
    status: str
    reason: str
    device: str
    jobs: int
    attempts: int
    seconds: float
    gpu_seconds: float


@dataclass(frozen=True)
class RunningAttempt:
    """An attempt that holds its job now. worker: the first, where there is one on each of several hosts.

    given: the GPUs that it was given of a pool; empty where it has its worker's. part: of its GPU's memory,
    if it shares the GPU, which counts as so much of a GPU.
    """

    project: str
    owner: str
    worker: str
    started_at: datetime
    hosts: int = 1
    given: str = ""
    part: float = 1.0

    @property
    def where(self) -> tuple[str, str]:
        """Its host, and what it has there."""
        host, device = host_and_device(self.worker)
        return host, self.given or device

    @property
    def num_gpus(self) -> float:
        """Those of all hosts."""
        return self.part * self.hosts * len(gpu_indices(self.where[1]))


@dataclass(frozen=True)
class UnfinishedJobs:
    """How many jobs of a project have this status, which is not final."""

    project: str
    status: str
    number: int


@dataclass(frozen=True)
class RecordNumbers:
    """The numbers of the record at one moment. beat_at: when the reconciler last reached the database."""

    moment: datetime
    beat_at: datetime | None
    unfinished: Sequence[UnfinishedJobs]
    running: Sequence[RunningAttempt]
    ended: Sequence[Ended]
    tallies: Sequence[Tally]


@dataclass(frozen=True)
class ProjectUsage:
    """What a user's jobs of a project took in a window, with those that run now, and how many wait now.

    owner: empty without accounts. oldest_queued_s: for how long the oldest of those that wait has, since its
    submission; None if none waits. bytes: of their jobs' files, their models and their clips, now.
    """

    project: str
    owner: str
    jobs: int = 0
    attempts: int = 0
    running: int = 0
    seconds: float = 0.0
    gpu_seconds: float = 0.0
    queued: int = 0
    oldest_queued_s: float | None = None
    bytes: int = 0


@dataclass(frozen=True)
class DeviceUsage:
    """The seconds for which a device had a job in each of the hours that `Usage.hours` names."""

    host: str
    device: str
    seconds: Sequence[float]


@dataclass(frozen=True)
class Usage:
    """What was used from `since`, the beginning of an hour, until now. hours: of the last day, by their
    beginnings, for the devices that had a job then."""

    since: datetime
    until: datetime
    projects: Sequence[ProjectUsage]
    hours: Sequence[datetime]
    devices: Sequence[DeviceUsage]


class UsageStore(Protocol):
    """Part of the record. Every method raises RecordsUnavailable when the store cannot be reached."""

    def numbers(self) -> RecordNumbers:
        """The numbers that monitoring shows. Its cost grows with the jobs that have not ended."""
        ...

    def usage(self, since: datetime) -> Usage:
        """The use since the beginning of that hour."""
        ...

    def set_half_life(self, span: timedelta) -> None:
        """After this time half of a use is forgotten where turns are given. What is forgotten stays so."""
        ...

    def add_tallies(self, tallies: Sequence[Tally]) -> None:
        """Add to the sums of all workers."""
        ...


def entries(job: Job, before: JobStatus) -> list[LedgerEntry]:
    """The entries that a change of a job's status adds to the ledger. before: its status until then."""
    attempt = job.attempts[-1] if before.is_held and not job.status.is_held else None
    if attempt is None and not job.status.is_final:
        return []
    ended_at = (attempt.ended_at if attempt else None) or job.finished_at
    if ended_at is None:  # No change of this version leaves that out.
        return []
    reason = (attempt.reason if attempt else None) or job.reason
    host, device = host_and_device(attempt.worker) if attempt else ("", "")
    if attempt and (given := attempt.details.get(GIVEN)):
        device = str(given)
    began_at = min(attempt.started_at, ended_at) if attempt else ended_at  # A clock may have been set back.
    part = 1.0 if attempt is None or attempt.gpu_part is None else attempt.gpu_part
    hours = list(hours_between(began_at, ended_at)) or [(beginning_of_hour(ended_at), 0.0)]
    last = hours[-1][0]
    return [
        LedgerEntry(
            hour=hour,
            project=job.project,
            owner=job.owner or "",
            host=host,
            device=device,
            status=job.status.value,
            reason=reason.value if reason else "",
            jobs=int(hour == last and job.status.is_final),
            attempts=int(hour == last and attempt is not None),
            seconds=seconds,
            gpu_seconds=seconds * part * len(gpu_indices(device)) * job.spec.resources.hosts,
        )
        for hour, seconds in hours
    ]


def usage_of(
    ended: Mapping[tuple[str, str], ProjectUsage],
    devices: Mapping[tuple[str, str], Mapping[datetime, float]],
    running: Sequence[RunningAttempt],
    *,
    since: datetime,
    day: datetime,
    until: datetime,
) -> Usage:
    """The sums of the ledger, and of the attempts that run now.

    ended: by project and user, from `since`, with what waits and is stored. devices: the seconds of each hour
    from `day`, by host and device.
    """
    projects, busy = dict(ended), {key: dict(hours) for key, hours in devices.items()}
    for attempt in running:
        who = (attempt.project, attempt.owner)
        used = projects.get(who, ProjectUsage(*who))
        seconds = max(0.0, (until - max(since, attempt.started_at)).total_seconds())
        projects[who] = replace(
            used,
            running=used.running + 1,
            seconds=used.seconds + seconds,
            gpu_seconds=used.gpu_seconds + seconds * attempt.num_gpus,
        )
        hours = busy.setdefault(attempt.where, {})
        for hour, part in hours_between(max(day, attempt.started_at), until):
            hours[hour] = hours.get(hour, 0.0) + part
    hours = [hour for hour, _ in hours_between(day, until)]
    busiest = sorted(busy.items(), key=lambda item: -sum(item[1].values()))[:MOST_DEVICES]
    return Usage(
        since=since,
        until=until,
        projects=sorted(projects.values(), key=lambda used: (-used.gpu_seconds, -used.seconds, -used.bytes)),
        hours=hours,
        devices=[
            DeviceUsage(*where, [min(said.get(hour, 0.0), HOUR.total_seconds()) for hour in hours])
            for where, said in sorted(busiest)
        ],
    )


def hours_between(begin: datetime, end: datetime) -> Iterator[tuple[datetime, float]]:
    """Each hour that the span touches, by its beginning, and the seconds of the span in it."""
    hour = beginning_of_hour(begin)
    while hour < end:
        yield hour, (min(end, hour + HOUR) - max(begin, hour)).total_seconds()
        hour += HOUR


def beginning_of_hour(moment: datetime) -> datetime:
    """In UTC, as the ledger has it."""
    return moment.astimezone(UTC).replace(minute=0, second=0, microsecond=0)
