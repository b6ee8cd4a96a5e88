"""What the retention rules of a project remove, over the real record and the real object store."""

from collections.abc import Sequence
from datetime import timedelta
from typing import Any

import pytest
from structlog.testing import capture_logs

from core.accounts.store import Actor
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.s3.objects import S3ObjectStore
from core.errors import JobNotFound, ProjectNotFound, Rejected, RetentionNeeded, StorageUnavailable
from core.jobs import orphans, removal
from core.jobs.ending import end_deletions
from core.jobs.job import Artifact, Job, Origin, new_job_id
from core.jobs.patch import JobPatch
from core.jobs.removal import Preview, check_needed, preview
from core.jobs.retention import PIN, EndedJob, Need, Removal, Retention, RetentionRules
from core.jobs.source import source_artifact
from core.jobs.status import JobStatus
from core.jobs.store import JobQuery
from core.jobs.submission import submit
from core.reasons import Reason
from core.storage import keys
from core.sweeps.actions import resume_sweep
from core.sweeps.spec import Budget
from core.sweeps.sweep import SweepStatus
from tests.contract.recording import NOW, Database, artifact, held, queued_job
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from tests.unit.sweeps.making import JOB, sweep_of, trial_of

ANN = Actor("ann")
MONTH_AGO = timedelta(days=30)
ROLES = {"checkpoint": "checkpoint", "video": "video", "policy": "policy", "replay": "replay"}


def file(job: Job, name: str, size: int = 1) -> Artifact:
    role, _, step = name.partition("-")
    key = keys.artifact(job.id, 1, f"{len(name):016d}", name)
    facts = {"role": ROLES[role], "step": int(step.strip("b")) if step else None, "key": key, "size": size}
    return artifact(name, **facts)


def ended(
    store: PostgresJobStore,
    objects: S3ObjectStore | MemoryObjectStore | None,
    job: Job,
    *names: str,
    status: JobStatus = JobStatus.SUCCEEDED,
) -> Job:
    """A job in the record that ended so long ago, with these files; in `objects` too, where given."""
    files = tuple(file(job, name) for name in names)
    if objects is not None:
        for one in files:
            objects.put(one.key, b"x")
    store.save(running := held(store, job).running())
    store.save(published := running.with_artifacts(files))
    if status == JobStatus.CANCELLED:
        store.save(published := published.become(JobStatus.CANCELLING))
    reason = Reason.COMPLETED if status == JobStatus.SUCCEEDED else Reason.DIVERGED
    store.save(last := published.ended(status, reason, "", store.now() - MONTH_AGO))
    return last


def set_rules(store: PostgresJobStore, **rules: int) -> Retention:
    return store.set_retention("default", RetentionRules(**rules), ANN)


def apply(store: PostgresJobStore, objects: Any) -> None:
    for _ in removal.apply(store=store, objects=objects):
        pass


def names_of(store: PostgresJobStore, job: Job) -> list[str]:
    return [one.name for one in store.get(job.id).artifacts]


def notes_of(store: PostgresJobStore, job: Job) -> list[str]:
    events = store.feed(job.id, "events").entries
    return [entry.data["text"] for entry in events if entry.kind == "note"]


def shown(store: PostgresJobStore, **rules: int) -> Preview:
    return preview("default", RetentionRules(**rules), store, most=50)


def test_rules_are_set_read_replaced_and_ended_and_the_audit_log_says_so(job_store: PostgresJobStore) -> None:
    assert job_store.retention("default") is None
    first = set_rules(job_store, checkpoints=2)
    assert (job_store.retention("default"), first.set_by) == (first, "ann")
    second = set_rules(job_store, videos_days=30)
    assert job_store.retentions() == [second]
    assert second.rules.given() == {"videos_days": 30}
    job_store.end_retention("default", ANN)
    job_store.end_retention("default", ANN)
    assert job_store.retentions() == []
    actions = [entry.action for entry in job_store.audit(object="project default").entries]
    assert actions == ["retention.ended", "retention.set", "retention.set"]
    with pytest.raises(ProjectNotFound):
        job_store.retention("nowhere")
    with pytest.raises(ProjectNotFound):
        job_store.set_retention("nowhere", RetentionRules(checkpoints=1), ANN)


def test_files_go_from_record_and_bucket_and_the_job_the_audit_log_and_a_refusal_say_why(
    job_store: PostgresJobStore, object_store: S3ObjectStore
) -> None:
    names = ("checkpoint-10", "checkpoint-20", "checkpoint-30", "video", "policy", "replay")
    job = ended(job_store, object_store, queued_job(), *names)
    set_rules(job_store, checkpoints=1, videos_days=30)
    apply(job_store, object_store)
    assert names_of(job_store, job) == ["checkpoint-30", "policy", "replay"]
    assert [used.bytes for used in job_store.usage(job_store.now()).projects] == [3]  # A byte each.
    assert {found.key for found in object_store.list("")} == set(job_store.objects_named([job.id]))
    assert notes_of(job_store, job) == [
        "By the retention rules of its project, `checkpoints` = 1 removed checkpoint-10, checkpoint-20; "
        "`videos_days` = 30 removed video."
    ]
    (entry,) = job_store.audit(action="retention.applied").entries
    assert (entry.object, entry.user) == ("project default", None)
    rules = {"checkpoints": 1, "videos_days": 30}
    assert entry.details == {"job": job.id, "whole": False, "rules": rules, "files": 3, "bytes": 3}
    found = job_store.get(job.id)
    assert {one.rule: (one.files, one.size) for one in found.removed} == {
        "checkpoints": (2, 2),
        "videos_days": (1, 1),
    }
    # What is stored counts against quotas.
    assert [used.bytes for used in job_store.usage(NOW).projects] == [3]
    resumed = queued_job(1, resume_from={"job": job.id, "step": 10}).spec
    assert resumed.source is not None
    with pytest.raises(Rejected) as refusal:
        source_artifact(resumed, resumed.source, job_store.get)
    today = f"{job_store.now():%Y-%m-%d}"
    assert refusal.value.detail == (
        f"Job {job.id} (succeeded) has no checkpoint of step 10; it has 30. The retention rule `checkpoints` "
        f"of its project removed older checkpoints on {today}."
    )
    # Nothing is left to do, and a later removal adds up.
    apply(job_store, object_store)
    assert job_store.get(job.id).version == found.version


def test_checkpoints_of_one_step_count_as_one(job_store: PostgresJobStore) -> None:
    job = ended(job_store, None, queued_job(), "checkpoint-1", "checkpoint-1b", "checkpoint-2")
    assert [shown(job_store, checkpoints=keep).files for keep in (2, 1)] == [0, 2]
    set_rules(job_store, checkpoints=1)
    apply(job_store, MemoryObjectStore())
    assert names_of(job_store, job) == ["checkpoint-2"]


def test_a_whole_job_goes_with_its_feeds(job_store: PostgresJobStore, object_store: S3ObjectStore) -> None:
    failed = ended(job_store, object_store, queued_job(), "policy", status=JobStatus.FAILED)
    cancelled = ended(job_store, object_store, queued_job(1), "policy", status=JobStatus.CANCELLED)
    ok = ended(job_store, object_store, queued_job(2), "policy")
    set_rules(job_store, failed_days=30)
    apply(job_store, object_store)
    with pytest.raises(JobNotFound):
        job_store.get(failed.id)
    assert {keys.job_of(found.key) for found in object_store.list("")} == {cancelled.id, ok.id}
    assert job_store.deletions() == [failed.id]
    (entry,) = job_store.audit(action="retention.applied").entries
    assert entry.details == {
        "job": failed.id,
        "whole": True,
        "rules": {"failed_days": 30},
        "files": 1,
        "bytes": 1,
    }


def test_a_thousand_jobs_lose_exactly_what_the_preview_has_shown(job_store: PostgresJobStore) -> None:
    objects = MemoryObjectStore()
    stati = (JobStatus.SUCCEEDED, JobStatus.FAILED, JobStatus.CANCELLED, JobStatus.SUCCEEDED)
    added = list[Job]()
    for number in range(1000):
        names = [f"checkpoint-{step}" for step in range(number % 5)] + ["video", "policy"]
        labels = {PIN: ""} if number % 50 == 0 else {}
        job = queued_job(number, labels=labels)
        files = tuple(file(job, name, size=number + 1) for name in names)
        for one in files:
            objects.put(one.key, b"x")
        days = timedelta(days=number % 60)
        status = stati[number % 4]
        done = job.model_copy(
            update={"status": status, "finished_at": job_store.now() - days, "artifacts": files}
        )
        added.append(job_store.add(done))
    # The last failed job that is old enough is needed.
    source = next(job for job in reversed(added) if job.status == JobStatus.FAILED and job.artifacts[:-2])
    job_store.add(queued_job(2000, resume_from={"job": source.id, "step": 0}))
    rules = {"checkpoints": 2, "videos_days": 30, "failed_days": 50}
    wanted = shown(job_store, **rules)
    assert wanted.pinned == 20
    sizes = [one.num_bytes for one in wanted.largest]
    assert (len(sizes), sizes) == (50, sorted(sizes, reverse=True))
    before = {found.key for found in objects.list("")}
    size_of = {one.key: (one.role, one.size) for job in added for one in job.artifacts}
    set_rules(job_store, **rules)
    apply(job_store, objects)
    gone = before - {found.key for found in objects.list("")}
    by_role: dict[str, tuple[int, int]] = {}
    for key in gone:
        role, size = size_of[key]
        files, total = by_role.get(role, (0, 0))
        by_role[role] = (files + 1, total + size)
    assert {role: (one.files, one.size) for role, one in wanted.roles.items()} == by_role
    assert len(gone) == wanted.files > 1000
    assert len({keys.job_of(key) for key in gone}) == wanted.jobs
    assert len(job_store.deletions()) == wanted.whole_jobs > 0
    assert shown(job_store, **rules).jobs == 0
    # No file is listed that is gone.
    left = [job for job in added if job.id not in job_store.deletions()]
    assert set(job_store.objects_named([job.id for job in left])) == before - gone


class Killed(BaseException):
    """The process ends at this point."""


class Dying(MemoryObjectStore):
    """An object store whose caller dies before anything is deleted."""

    is_deadly = True

    def delete(self, keys: Any) -> None:
        if self.is_deadly:
            raise Killed
        super().delete(keys)

    def delete_prefix(self, prefix: str) -> None:
        if self.is_deadly:
            raise Killed
        super().delete_prefix(prefix)


def test_a_kill_between_record_and_bucket_leaves_nothing_listed_and_nothing_behind(
    job_store: PostgresJobStore,
) -> None:
    objects = Dying(clock=lambda: NOW - timedelta(days=400))
    job = ended(job_store, objects, queued_job(), "checkpoint-1", "checkpoint-2", "policy")
    failed = ended(job_store, objects, queued_job(1), "policy", status=JobStatus.FAILED)
    set_rules(job_store, checkpoints=1, failed_days=1)
    for _ in range(2):
        with pytest.raises(Killed):
            apply(job_store, objects)
    assert names_of(job_store, job) == ["checkpoint-2", "policy"]
    assert len(list(objects.list(""))) == 4
    objects.is_deadly = False
    apply(job_store, objects)
    list(orphans.sweep(store=job_store, objects=objects))
    end_deletions(store=job_store, objects=objects, after=timedelta(0))
    assert {found.key for found in objects.list("")} == set(job_store.objects_named([job.id]))
    assert job_store.deletions() == []
    assert failed.id not in job_store.marks([failed.id])


def test_an_outage_of_the_bucket_ends_the_round(job_store: PostgresJobStore) -> None:
    class Away(MemoryObjectStore):
        def delete(self, keys: Any) -> None:
            raise StorageUnavailable("away")

    set_rules(job_store, checkpoints=1)
    for number in range(2):
        ended(job_store, None, queued_job(number), "checkpoint-1", "checkpoint-2")
    with pytest.raises(StorageUnavailable):
        apply(job_store, Away())


def test_rules_that_would_remove_what_a_waiting_job_needs_are_refused_with_the_job(
    job_store: PostgresJobStore, object_store: S3ObjectStore
) -> None:
    names = ("checkpoint-10", "checkpoint-20", "checkpoint-30", "policy")
    source = ended(job_store, object_store, queued_job(), *names)
    waiting = job_store.add(queued_job(1, resume_from={"job": source.id, "step": 10}))
    with pytest.raises(RetentionNeeded, match=f"job {source.id} is needed by {waiting.id}") as refusal:
        check_needed("default", RetentionRules(checkpoints=1), job_store)
    assert refusal.value.facts["needed"] == {source.id: [waiting.id]}
    check_needed("default", RetentionRules(checkpoints=3), job_store)
    # Rules that were set before it was submitted wait for its end.
    set_rules(job_store, checkpoints=1)
    found = shown(job_store, checkpoints=1)
    assert [(one.job.id, one.needs) for one in found.needed] == [(source.id, [Need(waiting.id, 10)])]
    apply(job_store, object_store)
    assert names_of(job_store, source) == ["checkpoint-10", "checkpoint-30", "policy"]
    job_store.save(waiting.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", job_store.now()))
    apply(job_store, object_store)
    assert names_of(job_store, source) == ["checkpoint-30", "policy"]
    assert [one.files for one in job_store.get(source.id).removed] == [2]


def test_only_jobs_that_others_need_are_read_before_rules_are_set(
    job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = list[str]()
    ended_jobs = job_store.ended_jobs

    def noting(project: str, **which: Any) -> Sequence[EndedJob]:
        found = ended_jobs(project, **which)
        read.extend(job.id for job in found)
        return found

    monkeypatch.setattr(job_store, "ended_jobs", noting)
    source, _ = (ended(job_store, None, queued_job(at), "checkpoint-1", "checkpoint-2") for at in (0, 1))
    check_needed("default", RetentionRules(checkpoints=1), job_store)
    assert read == []
    job_store.add(queued_job(2, resume_from={"job": source.id, "step": 1}))
    with pytest.raises(RetentionNeeded):
        check_needed("default", RetentionRules(checkpoints=1), job_store)
    assert read == [source.id]


@pytest.fixture
def judged(job_store: PostgresJobStore) -> tuple[Job, Removal, Retention]:
    """A job, what the rules remove of it, and the rules; nothing is removed yet."""
    job = ended(job_store, None, queued_job(), "checkpoint-10", "checkpoint-20")
    rules = set_rules(job_store, checkpoints=1)
    ((verdict,),) = removal.verdicts("default", rules.rules, job_store)
    assert verdict.removal is not None
    return job, verdict.removal, rules


def test_a_job_that_needs_the_file_by_now_keeps_it(
    job_store: PostgresJobStore, judged: tuple[Job, Removal, Retention]
) -> None:
    job, planned, rules = judged
    job_store.add(queued_job(1, resume_from={"job": job.id, "step": 10}))
    assert job_store.remove_retained(planned, rules) is None
    assert names_of(job_store, job) == ["checkpoint-10", "checkpoint-20"]


def test_a_job_that_is_pinned_by_now_keeps_all(
    job_store: PostgresJobStore, judged: tuple[Job, Removal, Retention]
) -> None:
    job, planned, rules = judged
    job_store.patch(job.id, JobPatch(labels={PIN: "yes"}))
    assert job_store.remove_retained(planned, rules) is None


def test_a_job_that_a_new_sweep_needs_keeps_all(
    job_store: PostgresJobStore, judged: tuple[Job, Removal, Retention]
) -> None:
    job, planned, rules = judged
    job_store.add_sweep(sweep_of(job={**JOB, "resume_from": {"job": job.id}}))
    assert job_store.remove_retained(planned, rules) is None
    assert names_of(job_store, job) == ["checkpoint-10", "checkpoint-20"]


def test_a_sweep_that_comes_or_is_resumed_too_late_is_refused_with_the_reason(
    job_store: PostgresJobStore, judged: tuple[Job, Removal, Retention]
) -> None:
    job, planned, rules = judged
    needing = sweep_of(job={**JOB, "resume_from": {"job": job.id, "step": 10}})
    job_store.add_sweep(needing)
    job_store.save_sweep(over := needing.next(status=SweepStatus.CANCELLED))
    late = needing.model_copy(update={"id": new_job_id(NOW)})
    assert job_store.remove_retained(planned, rules) is not None
    with pytest.raises(JobNotFound):
        job_store.add_sweep(late)
    assert [one.id for one in job_store.list_sweeps().sweeps] == [over.id]
    with pytest.raises(Rejected, match="The retention rule `checkpoints` of its project removed") as refusal:
        resume_sweep(over.id, Budget(), store=job_store)
    assert [one.pointer for one in refusal.value.problems] == ["/job/resume_from/step"]
    assert job_store.get_sweep(over.id) == over


def test_a_job_that_comes_too_late_is_refused_with_the_reason(
    job_store: PostgresJobStore, judged: tuple[Job, Removal, Retention]
) -> None:
    """It was checked before the removal, and is stored after it."""
    job, planned, rules = judged
    late = queued_job(1, resume_from={"job": job.id, "step": 10})
    assert job_store.remove_retained(planned, rules) is not None
    with pytest.raises(JobNotFound):
        job_store.add(late)
    with pytest.raises(Rejected, match="The retention rule `checkpoints` of its project removed"):
        submit(late.spec, store=job_store, queue=MemoryJobQueue())
    assert len(job_store.list(JobQuery()).jobs) == 1


def test_old_rules_remove_nothing_once_they_are_changed_and_two_reconcilers_remove_once(
    job_store: PostgresJobStore, judged: tuple[Job, Removal, Retention]
) -> None:
    job, planned, rules = judged
    newer = set_rules(job_store, checkpoints=1)
    assert job_store.remove_retained(planned, rules) is None
    assert job_store.remove_retained(planned, newer) is not None
    assert job_store.remove_retained(planned, newer) is None
    assert len(notes_of(job_store, job)) == 1


def test_pinned_jobs_and_those_of_sweeps_that_go_on_lose_nothing(job_store: PostgresJobStore) -> None:
    names = ("checkpoint-1", "checkpoint-2")
    ended(job_store, None, queued_job(0, labels={PIN: "for the paper"}), *names)
    of_trial = ended(job_store, None, queued_job(1), *names)
    named = ended(job_store, None, queued_job(2), *names)
    sweep = job_store.add_sweep(sweep_of(job={**JOB, "resume_from": {"job": named.id}}))
    job_store.add_trial(sweep.id, trial_of(0, job=of_trial.id), None)
    found = shown(job_store, checkpoints=1)
    assert (found.jobs, found.pinned) == (0, 1)
    assert {one.job.id: one.sweep for one in found.needed} == {of_trial.id: sweep.id, named.id: sweep.id}
    # A sweep is no reason to refuse rules: its files wait.
    check_needed("default", RetentionRules(checkpoints=1), job_store)


def test_rules_reach_the_jobs_of_all_pages(
    job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("core.jobs.removal._PAGE", 2)
    for number in range(5):
        ended(job_store, None, queued_job(number), "video")
    assert shown(job_store, videos_days=1).jobs == 5
    set_rules(job_store, videos_days=1)
    apply(job_store, MemoryObjectStore())
    assert shown(job_store, videos_days=1).jobs == 0


def test_days_count_from_an_import_and_other_projects_are_not_touched(job_store: PostgresJobStore) -> None:
    origin = Origin(job=queued_job(9).id, version="1", imported_at=job_store.now())
    long_ago = job_store.now() - timedelta(days=900)
    done = {"status": JobStatus.SUCCEEDED, "finished_at": long_ago}
    job = queued_job()
    video = (file(job, "video"),)
    job_store.import_job(job.model_copy(update={**done, "imported_from": origin, "artifacts": video}), [], [])
    theirs = queued_job(1).model_copy(update={**done, "project": "theirs", "artifacts": video})
    job_store.add(theirs)
    assert shown(job_store, videos_days=1).jobs == 0


def test_one_damaged_row_stops_no_other(job_store: PostgresJobStore, database: Database) -> None:
    damaged = ended(job_store, None, queued_job(), "video", "checkpoint-1", "checkpoint-2")
    origin = '{"job": "x", "version": "1", "imported_at": "once"}'
    database.damage(damaged, imported_from=origin, removed='{"rule": 1}')
    whole = ended(job_store, None, queued_job(1), "video")
    set_rules(job_store, checkpoints=1, videos_days=1)
    database.change("INSERT INTO projects (name, created_at) VALUES ('aaa', now())")
    bad = '{"checkpoints": 0}'
    database.change("INSERT INTO retention (project, rules, set_at) VALUES ('aaa', %s, now())", bad)
    with capture_logs() as said:
        apply(job_store, MemoryObjectStore())
        assert job_store.retention("aaa") is None
    # Nobody knows since when days count.
    left = set(job_store.objects_named([damaged.id, whole.id]))
    assert left == {file(damaged, name).key for name in ("video", "checkpoint-2")}
    assert {entry["event"] for entry in said} >= {
        "retention_unreadable",
        "origin_unreadable",
        "removed_unreadable",
    }


def test_unreadable_rules_and_jobs_do_no_harm(job_store: PostgresJobStore, database: Database) -> None:
    job = ended(job_store, None, queued_job(), "checkpoint-1", "checkpoint-2")
    set_rules(job_store, checkpoints=1)
    database.damage(job, spec="{")
    database.change("UPDATE retention SET rules = %s", '{"checkpoints": 1, "of_a_later_version": 3}')
    apply(job_store, MemoryObjectStore())
    assert [key for key in job_store.objects_named([job.id]) if "checkpoint-1" in key] == []
