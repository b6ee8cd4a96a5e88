"""What the retention rules of a project remove: shown before, refused where a job needs it, and then done."""

import heapq
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import structlog

from core.errors import RetentionNeeded
from core.jobs.retention import (
    EndedJob,
    Limits,
    Need,
    Removal,
    Retention,
    RetentionRules,
    Rule,
    Verdict,
    choice,
    judge,
    rules_due,
)
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectStore

log = structlog.get_logger()

_PAGE = 1000
_Needs = Mapping[str, Sequence[Need]]


@dataclass
class RoleSum:
    """Files of one role. size: their bytes."""

    files: int = 0
    size: int = 0

    def add(self, files: int, size: int) -> None:
        self.files += files
        self.size += size


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
    project: str, rules: RetentionRules, store: JobStore, *, ids: Collection[str] | None = None
) -> Iterator[Sequence[Verdict]]:
    """What the rules say of each ended job, a page at a time, the oldest jobs first.

    ids: only of these. Raises RecordsUnavailable.
    """
    needs, limits = store.checkpoint_needs(project), rules.limits(store.now())
    for jobs in _pages(project, store, ids):
        yield _judged(jobs, rules, limits, needs, store)


def preview(project: str, rules: RetentionRules, store: JobStore, *, most: int) -> Preview:
    """What the rules would remove now. most: how many jobs are named. Raises RecordsUnavailable.

    Of jobs that nobody needs the record sums the chosen files, and only of those named they are read.
    """
    found, sizes = Preview(), list[tuple[int, str]]()
    needs, limits = store.checkpoint_needs(project), rules.limits(store.now())
    roles = defaultdict[str, RoleSum](RoleSum)
    for jobs in _pages(project, store):
        found.pinned += sum(job.is_pinned for job in jobs)
        needed = [job for job in jobs if _is_needed(job, needs)]
        for verdict in _judged(needed, rules, limits, needs, store):
            if verdict.needs or verdict.sweep:
                found.num_needed += 1
                found.needed += [verdict][: most - len(found.needed)]
            if (removal := verdict.removal) is not None:
                sizes.append((removal.num_bytes, verdict.job.id))
                for file in removal.all_files:
                    roles[file.role].add(file.number, file.size)
        free = [job for job in jobs if not _is_needed(job, needs)]
        for (due, _), alike in _alike(free, limits, needs).items():
            chosen = choice(rules, due, is_needed=False)
            sums = store.sums_of_ended([job.id for job in alike], chosen)
            found.whole_jobs += len(alike) if chosen.is_whole else 0
            losing = [job.id for job in alike] if chosen.is_whole else sums.by_job
            sizes += [(sums.by_job.get(job_id, (0, 0))[1], job_id) for job_id in losing]
            for role, sum_of_role in sums.by_role.items():
                roles[role].add(*sum_of_role)
    found.jobs = len(sizes)
    found.roles = dict(sorted(roles.items(), key=lambda item: -item[1].size))
    largest = [job_id for _, job_id in heapq.nlargest(most, sizes)]
    removals = [one.removal for page in verdicts(project, rules, store, ids=largest) for one in page]
    by_size = sorted(filter(None, removals), key=lambda one: (one.num_bytes, one.job.id), reverse=True)
    found.largest = by_size
    return found


def _pages(project: str, store: JobStore, ids: Collection[str] | None = None) -> Iterator[Sequence[EndedJob]]:
    after = ""
    while jobs := store.ended_jobs(project, ids=ids, after=after, limit=_PAGE):
        after = jobs[-1].id
        yield jobs


def _judged(
    jobs: Sequence[EndedJob], rules: RetentionRules, limits: Limits, needs: _Needs, store: JobStore
) -> Sequence[Verdict]:
    found = list[Verdict]()
    for (due, is_needed), alike in _alike(jobs, limits, needs).items():
        chosen = choice(rules, due, is_needed=is_needed)
        files = store.files_of_ended([job.id for job in alike], chosen)
        found += [judge(job, due, files.get(job.id, ()), needs.get(job.id, ())) for job in alike]
    return sorted(found, key=lambda one: one.job.id)


def _alike(
    jobs: Sequence[EndedJob], limits: Limits, needs: _Needs
) -> Mapping[tuple[Sequence[Rule], bool], Sequence[EndedJob]]:
    """The jobs by the rules that are due of them, and whether somebody needs them."""
    found = defaultdict[tuple[Sequence[Rule], bool], list[EndedJob]](list)
    for job in jobs:
        found[rules_due(job, limits), _is_needed(job, needs)].append(job)
    return found


def _is_needed(job: EndedJob, needs: _Needs) -> bool:
    return job.sweep is not None or job.id in needs


def check_needed(project: str, rules: RetentionRules, store: JobStore) -> None:
    """Refuse rules that would remove now what a waiting or running job needs.

    Raises RetentionNeeded, RecordsUnavailable.
    """
    needed: dict[str, Sequence[str]] = {}
    for page in verdicts(project, rules, store, ids=store.checkpoint_needs(project)):
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
