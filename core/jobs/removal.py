"""What the retention rules of a project remove: shown before, refused where a job needs it, and then done."""

import heapq
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field

import structlog

from core.errors import RetentionNeeded
from core.jobs.retention import (
    Removal,
    RetainedFile,
    Retention,
    RetentionRules,
    Verdict,
    judge,
    roles_at_stake,
)
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectStore

log = structlog.get_logger()

_PAGE = 1000


@dataclass
class RoleSum:
    """Files of one role. size: their bytes."""

    files: int = 0
    size: int = 0


@dataclass
class Preview:
    """What rules remove now. jobs, whole_jobs: how many lose something, and how many of them all.

    largest: those that free most, the most first. needed: some of the `num_needed` jobs that lose less,
    because others need it. pinned: how many jobs have the label `keep`.
    """

    jobs: int = 0
    whole_jobs: int = 0
    roles: dict[str, RoleSum] = field(default_factory=dict[str, RoleSum])
    largest: Sequence[Removal] = ()
    needed: list[Verdict] = field(default_factory=list[Verdict])
    num_needed: int = 0
    pinned: int = 0

    @property
    def files(self) -> int:
        return sum(role.files for role in self.roles.values())

    @property
    def size(self) -> int:
        return sum(role.size for role in self.roles.values())


def verdicts(
    project: str, rules: RetentionRules, store: JobStore, *, of_needed: bool = False
) -> Iterator[Sequence[Verdict]]:
    """What the rules say of each ended job, a page at a time, the oldest jobs first.

    of_needed: only of jobs whose checkpoints others need. Raises RecordsUnavailable.
    """
    now, needs, after = store.now(), store.checkpoint_needs(project), ""
    if of_needed and not needs:
        return
    ids = needs.keys() if of_needed else None
    while jobs := store.ended_jobs(project, ids=ids, after=after, limit=_PAGE):
        after = jobs[-1].id
        by_roles = defaultdict[Collection[str] | None, list[str]](list)
        for job in jobs:
            by_roles[roles_at_stake(rules, job, needs.get(job.id, ()), now)].append(job.id)
        files: dict[str, Sequence[RetainedFile]] = {}
        for roles, alike in by_roles.items():
            files |= store.sums_of_ended(alike) if roles is None else store.files_of_ended(alike, roles)
        yield [judge(rules, job, files.get(job.id, ()), needs.get(job.id, ()), now) for job in jobs]


def preview(project: str, rules: RetentionRules, store: JobStore, *, most: int) -> Preview:
    """What the rules would remove now. most: how many jobs are named. Raises RecordsUnavailable."""
    found = Preview()
    roles = defaultdict[str, RoleSum](RoleSum)
    largest: list[tuple[int, str, Removal]] = []
    for page in verdicts(project, rules, store):
        for verdict in page:
            found.pinned += verdict.job.is_pinned
            if verdict.needs or verdict.sweep:
                found.num_needed += 1
                if len(found.needed) < most:
                    found.needed.append(verdict)
            if (removal := verdict.removal) is None:
                continue
            found.jobs += 1
            found.whole_jobs += removal.is_whole
            for file in removal.all_files:
                role = roles[file.role]
                role.files += file.number
                role.size += file.size
            entry = (removal.num_bytes, removal.job.id, removal)
            if len(largest) < most:
                heapq.heappush(largest, entry)
            else:
                heapq.heappushpop(largest, entry)
    found.roles = dict(sorted(roles.items(), key=lambda item: -item[1].size))
    found.largest = [removal for *_, removal in sorted(largest, key=lambda entry: entry[:2], reverse=True)]
    return found


def check_needed(project: str, rules: RetentionRules, store: JobStore) -> None:
    """Refuse rules that would remove now what a waiting or running job needs.

    Raises RetentionNeeded, RecordsUnavailable.
    """
    needed: dict[str, Sequence[str]] = {}
    for page in verdicts(project, rules, store, of_needed=True):
        # What a sweep needs waits for its end, which is no reason to refuse.
        needed |= {one.job.id: [need.job for need in one.needs] for one in page if one.needs}
    if needed:
        raise RetentionNeeded(project, needed)


def apply(*, store: JobStore, objects: ObjectStore) -> Iterator[None]:
    """Remove what the rules of all projects remove; it yields after each job and each page of jobs.

    The record comes first, so that nobody is shown a file that is gone. Objects that an interruption leaves
    are removed as orphans (`core.jobs.orphans`), those of whole jobs by `end_deletions`.
    Raises RecordsUnavailable, StorageUnavailable.
    """
    for by in store.retentions():
        jobs = 0
        for page in verdicts(by.project, by.rules, store):
            for verdict in page:
                if verdict.removal is not None:
                    jobs += _remove(verdict.removal, by, store, objects)
                    yield
            yield
        if jobs:
            log.info("retention_applied", project=by.project, jobs=jobs)


def _remove(removal: Removal, by: Retention, store: JobStore, objects: ObjectStore) -> bool:
    """Whether anything was removed; see `remove_retained`."""
    gone = store.remove_retained(removal, by)
    if gone is None:
        return False
    if removal.is_whole:
        objects.delete_prefix(keys.job(removal.job.id))
    else:
        objects.delete(gone)
    return True
