"""What the record promises of jobs, models and workers.

Its other promises: test_leases.py, test_job_feeds.py, test_lost_answers.py, test_lost_server.py.
"""

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from functools import partial

import pytest
from structlog.testing import capture_logs

from core.accounts.principal import NOBODYS
from core.clips.record import ClipFacts, ClipsDescription
from core.environments.terms.inventory import Inventory, Sizes
from core.errors import (
    ClipsInUse,
    ClipsNotFound,
    IdempotencyKeyReused,
    JobExists,
    JobNotFound,
    JobUnreadable,
    ModelInUse,
    ModelNotFound,
    Rejected,
    StaleJob,
)
from core.jobs.job import Job, Progress, UnreadableJob, new_job_id
from core.jobs.patch import JobPatch
from core.jobs.status import JobStatus
from core.jobs.store import Dispatch, Idempotency, JobQuery, JobStore
from core.reasons import Reason
from core.user_models.record import Description
from tests.contract.recording import (
    CLIPS,
    LEASE,
    MODEL,
    NOW,
    Database,
    artifact,
    at_once,
    cancelled,
    chunk_of,
    clip_file,
    held,
    model,
    queued_job,
    say,
    statuses,
    watch,
    worker,
)

ANY = JobQuery()


class TestJobs:
    def test_what_was_added_is_read_back_equal(self, jobs: JobStore) -> None:
        job = queued_job(name="erste Schritte – 初めて 🐜", labels={"project": "vnl"}, seed=7)
        assert jobs.add(job) == job
        assert jobs.get(job.id) == job
        assert jobs.find(job.id) == job

    def test_every_part_of_a_job_is_read_back_equal(self, jobs: JobStore) -> None:
        details = {"hyperparameters": {"num_envs": 64, "gamma": 0.99}, "odd": "a\0b", "none": None}
        running = held(jobs, queued_job()).running(device="cpu", engine="native", details=details)
        jobs.save(running)
        files = (
            artifact("b", metadata={"reward": 1.5}),
            artifact("a", role="checkpoint", step=10**11, size=2**40),
        )
        published = running.with_artifacts(files)
        jobs.save(published)
        requeued = published.requeued(Reason.WORKER_LOST, "Silent.", NOW + timedelta(microseconds=1))
        jobs.save(requeued)
        jobs.save(ended := requeued.claimed("worker-2", NOW))
        jobs.save(ended := ended.ended(JobStatus.FAILED, Reason.DIVERGED, "NaN at 7 – 初", NOW))
        assert jobs.get(ended.id) == ended
        assert list(jobs.list(ANY).jobs) == [ended]

    def test_an_unknown_job_is_not_found(self, jobs: JobStore) -> None:
        for look in (jobs.get, jobs.find):
            with pytest.raises(JobNotFound):
                look(new_job_id(NOW))

    @pytest.mark.parametrize("job_id", ["", "..", "a:events", "x" * 300, "0\0", "*"])
    def test_what_cannot_be_an_id_is_not_found(self, jobs: JobStore, job_id: str) -> None:
        with pytest.raises(JobNotFound):
            jobs.get(job_id)

    def test_an_id_is_given_once(self, jobs: JobStore) -> None:
        job = queued_job()
        jobs.add(job)
        with pytest.raises(JobExists):
            jobs.add(job.model_copy(update={"message": "another"}))
        assert jobs.get(job.id) == job

    def test_the_next_version_replaces_the_one_before(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.save(claimed.running(device="cpu", engine="native"))
        stored = jobs.get(claimed.id)
        assert stored == claimed.running(device="cpu", engine="native")
        assert (stored.version, stored.attempts[0].device) == (3, "cpu")

    def test_a_stale_save_is_refused_and_changes_nothing(self, jobs: JobStore) -> None:
        job = queued_job()
        claimed = held(jobs, job)
        with pytest.raises(StaleJob):
            jobs.save(job.ended(JobStatus.FAILED, Reason.DIVERGED, "", NOW))
        assert jobs.get(job.id) == claimed
        assert len(statuses(jobs, job)) == 1

    def test_the_same_version_is_saved_once(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        with pytest.raises(StaleJob):
            jobs.save(claimed)

    def test_a_version_left_out_is_refused(self, jobs: JobStore) -> None:
        job = queued_job()
        jobs.add(job)
        with pytest.raises(StaleJob):
            jobs.save(job.next().next())

    def test_saving_an_unknown_job_is_not_found(self, jobs: JobStore) -> None:
        with pytest.raises(JobNotFound):
            jobs.save(queued_job().next())

    def test_of_many_that_save_at_once_one_wins(self, jobs: JobStore) -> None:
        job = queued_job()
        jobs.add(job)
        claims = [job.claimed(f"worker-{number}", NOW) for number in range(8)]
        won = at_once([partial(jobs.save, claim, lease=LEASE) for claim in claims], StaleJob)
        assert won.count(True) == 1
        assert jobs.get(job.id) == claims[won.index(True)]

    def test_a_change_of_status_is_told_in_the_events(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        running = claimed.running(device="cpu")
        jobs.save(running)
        jobs.save(running.next(message="no new status"))
        jobs.save(running.next().ended(JobStatus.FAILED, Reason.DIVERGED, "NaN at 7", NOW))
        assert [entry.data for entry in statuses(jobs, claimed)] == [
            {"status": "starting", "reason": None, "message": None, "attempt": 1},
            {"status": "running", "reason": None, "message": None, "attempt": 1},
            {"status": "failed", "reason": "diverged", "message": "NaN at 7", "attempt": 1},
        ]

    def test_a_patch_and_the_steps_of_an_attempt_take_nothing_from_each_other(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job(name="a", labels={"team": "legs"}))
        patched = jobs.patch(claimed.id, JobPatch(name="b", labels={"knee": "soft"}, note="Watch it."))
        jobs.save(claimed.running(device="cpu"))  # It has read the job before the patch.
        found = jobs.get(claimed.id)
        assert isinstance(patched, Job)
        assert (found.spec, patched.token, patched.version) == (patched.spec, claimed.token, claimed.version)
        assert (found.spec.name, found.spec.note) == ("b", "Watch it.")
        assert found.spec.labels == {"team": "legs", "knee": "soft"}
        jobs.patch(claimed.id, JobPatch(name=None))
        assert jobs.list(JobQuery(search="WATCH")).jobs == [jobs.get(claimed.id)]
        assert jobs.list(JobQuery(name="b")).jobs == []

    def test_of_many_patches_at_once_all_stand(self, jobs: JobStore) -> None:
        job = jobs.add(queued_job())
        steps = [partial(jobs.patch, job.id, JobPatch(labels={f"l{n}": ""})) for n in range(6)]
        assert at_once(steps, StaleJob) == [True] * 6
        assert set(jobs.get(job.id).spec.labels) == {f"l{n}" for n in range(6)}

    def test_artifacts_are_replaced_kept_and_struck_in_their_order(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        first = claimed.with_artifacts((artifact("b"), artifact("a"), artifact("c")))
        jobs.save(first)
        struck = first.without_artifacts([artifact("a")])
        jobs.save(struck, note="It was lost.")
        assert jobs.feed(claimed.id, "events").entries[-1].data == {"text": "It was lost."}
        newer = artifact("b", key="of b, newer", sha256="1" * 64)
        replaced = struck.with_artifacts((newer, artifact("a")))
        jobs.save(replaced)
        assert jobs.get(claimed.id).artifacts == (newer, artifact("c"), artifact("a"))

    def test_what_a_process_said_may_hold_any_character(self, jobs: JobStore) -> None:
        # PostgreSQL's text has no U+0000.
        claimed = held(jobs, queued_job())
        jobs.save(claimed.ended(JobStatus.FAILED, Reason.TRAINING_CRASHED, "a\0b 初", NOW))
        stored = jobs.get(claimed.id)
        assert (stored.message, stored.attempts[0].message) == ("a\ufffdb 初", "a\ufffdb 初")

    def test_a_deleted_job_leaves_nothing(self, jobs: JobStore, database: Database) -> None:
        claimed = held(jobs, queued_job())
        say(jobs, claimed, "a", "b")
        jobs.replace_by_chunk(claimed.id, chunk_of(jobs.oldest_entries(claimed.id, "logs", limit=1)))
        jobs.save(published := claimed.with_artifacts((artifact("a"),)))
        watch(jobs, database)
        jobs.delete(claimed.id, published.version)
        with pytest.raises(JobNotFound):
            jobs.get(claimed.id)
        with pytest.raises(JobNotFound):
            jobs.feed(claimed.id, "logs")
        assert (list(jobs.list(ANY).jobs), list(jobs.expired()), jobs.undispatched()) == ([], [], [])
        for table in ("jobs", "attempts", "artifacts", "chunks", "entries", "dispatches"):
            assert database.count(table) == 0
        # But that its objects are to be removed.
        assert jobs.deletions() == [claimed.id]
        assert jobs.deletions(before=timedelta(minutes=1)) == []
        jobs.deletion_ended(claimed.id)
        assert jobs.deletions() == []

    def test_deleting_an_older_version_is_refused(self, jobs: JobStore) -> None:
        job = queued_job()
        claimed = held(jobs, job)
        with pytest.raises(StaleJob):
            jobs.delete(job.id, job.version)
        assert jobs.get(job.id) == claimed

    def test_deleting_an_unknown_job_is_not_found(self, jobs: JobStore) -> None:
        with pytest.raises(JobNotFound):
            jobs.delete(new_job_id(NOW), 1)

    def test_a_finished_job_can_be_added(self, jobs: JobStore) -> None:
        ended = cancelled(queued_job())
        jobs.add(ended)
        assert jobs.get(ended.id) == ended
        assert (jobs.undispatched(), jobs.waiting()) == ([], [])


class TestIdempotency:
    def test_the_same_key_and_body_give_the_first_job(self, jobs: JobStore) -> None:
        first, second = queued_job(0), queued_job(1)
        jobs.add(first, Idempotency("k", "body"))
        assert jobs.add(second, Idempotency("k", "body")) == first
        assert jobs.remembered(Idempotency("k", "body")) == first
        assert list(jobs.list(ANY).jobs) == [first]

    def test_the_first_job_is_given_as_it_is_now(self, jobs: JobStore) -> None:
        job = queued_job()
        jobs.add(job, Idempotency("k", "body"))
        jobs.save(job.claimed("worker-1", NOW))
        assert jobs.add(queued_job(), Idempotency("k", "body")).status == JobStatus.STARTING

    def test_another_body_is_refused(self, jobs: JobStore) -> None:
        first = queued_job(0)
        jobs.add(first, Idempotency("k", "body"))
        with pytest.raises(IdempotencyKeyReused):
            jobs.add(queued_job(1), Idempotency("k", "other"))
        with pytest.raises(IdempotencyKeyReused):
            jobs.remembered(Idempotency("k", "other"))
        assert list(jobs.list(ANY).jobs) == [first]

    def test_a_key_never_seen_is_not_remembered(self, jobs: JobStore) -> None:
        assert jobs.remembered(Idempotency("k", "body")) is None

    @pytest.mark.parametrize("key", ["é ü 日本", "a\0b", "k" * 10_000, ":*?", "\udce9"])
    def test_any_text_is_a_key(self, jobs: JobStore, key: str) -> None:
        job = queued_job()
        jobs.add(job, Idempotency(key, "body"))
        assert jobs.remembered(Idempotency(key, "body")) == job

    def test_the_key_of_a_deleted_job_is_free(self, jobs: JobStore) -> None:
        job, another = queued_job(0), queued_job(1)
        jobs.add(job, Idempotency("k", "body"))
        jobs.delete(job.id, job.version)
        assert jobs.remembered(Idempotency("k", "body")) is None
        assert jobs.add(another, Idempotency("k", "body")) == another

    def test_a_key_is_remembered_for_a_day(self, jobs: JobStore, database: Database) -> None:
        job, another = queued_job(0), queued_job(1)
        jobs.add(job, Idempotency("k", "body"))
        for hours, known in ((23, job), (1, None)):
            passed = timedelta(hours=hours)
            database.change("UPDATE idempotency_keys SET forgotten_at = forgotten_at - %s", passed)
            assert jobs.remembered(Idempotency("k", "body")) == known
        assert jobs.add(another, Idempotency("k", "other")) == another
        assert jobs.remembered(Idempotency("k", "other")) == another

    def test_of_many_that_submit_at_once_one_job_comes(self, jobs: JobStore) -> None:
        together = threading.Barrier(8)

        def submit(number: int) -> str:
            together.wait()
            return jobs.add(queued_job(number), Idempotency("k", "body")).id

        with ThreadPoolExecutor(8) as pool:
            ids = set(pool.map(submit, range(8)))
        assert [job.id for job in jobs.list(ANY).jobs] == list(ids)


class TestListing:
    def test_newest_first_in_pages_without_gap_or_repetition(self, jobs: JobStore) -> None:
        added = [queued_job(i) for i in range(7)]
        for job in added:
            jobs.add(job)
        got: list[Job | UnreadableJob] = []
        sizes: list[int] = []
        cursor: str | None = None
        while cursor is not None or not sizes:
            page = jobs.list(ANY, cursor=cursor, limit=3)
            got += page.jobs
            sizes.append(len(page.jobs))
            cursor = page.next_cursor
        assert got == added[::-1]
        assert sizes == [3, 3, 1]

    def test_a_last_page_that_is_full_has_no_next(self, jobs: JobStore) -> None:
        for i in range(4):
            jobs.add(queued_job(i))
        first = jobs.list(ANY, limit=2)
        assert jobs.list(ANY, cursor=first.next_cursor, limit=2).next_cursor is None

    def test_pages_stay_while_new_jobs_arrive_and_old_ones_go(self, jobs: JobStore) -> None:
        a, b, c, d = (queued_job(i) for i in range(4))
        for job in (a, b, c):
            jobs.add(job)
        page = jobs.list(ANY, limit=1)
        jobs.add(d)
        jobs.delete(c.id, c.version)
        assert list(jobs.list(ANY, cursor=page.next_cursor).jobs) == [b, a]

    def test_a_match_beyond_the_newest_is_found_by_one_filter_and_by_several(
        self, jobs: JobStore, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        # Several filters look at the newest jobs first, here at ten: the only match lies behind these.
        monkeypatch.setattr("core.adapters.postgres.listing._NEAR", 10)
        added = [queued_job(i, name="it" if i == 3 else None, labels={"i": str(i)}) for i in range(30)]
        for job in added:
            jobs.add(job)
        for query in (JobQuery(name="it"), JobQuery(labels={"i": "3"}), JobQuery(name="it", kind="train")):
            page = jobs.list(query, limit=1)
            assert (list(page.jobs), page.next_cursor) == ([added[3]], None)
        # Nine are among the newest, and the next page begins behind them.
        several = JobQuery(kind="train", environment="ant")
        first = jobs.list(several, limit=9)
        rest = jobs.list(several, cursor=first.next_cursor, limit=100)
        assert [*first.jobs, *rest.jobs] == added[::-1]

    @pytest.mark.parametrize(
        ("query", "expected"),
        [
            (JobQuery(status=JobStatus.CANCELLED), [1]),
            (JobQuery(kind="rollout"), [2]),
            (JobQuery(environment="hopper"), [3]),
            (JobQuery(name="first steps"), [0]),
            (JobQuery(labels={"project": "vnl"}), [1, 0]),
            (JobQuery(labels={"project": "vnl", "arm": "b"}), [1]),
            (JobQuery(environment="ant", labels={"arm": "b"}), [1]),
            (JobQuery(name="nobody"), []),
            (JobQuery(labels={"project": "VNL"}), []),
            (JobQuery(search="ST STEP"), [0]),
            (JobQuery(search="hop"), [3]),
            (JobQuery(search="ant", labels={"arm": "b"}), [1]),
            (JobQuery(search="first_steps"), []),  # `_` stands for itself.
            (JobQuery(search="%"), []),
        ],
    )
    def test_filters(self, jobs: JobStore, query: JobQuery, expected: list[int]) -> None:
        added = [
            queued_job(0, name="first steps", labels={"project": "vnl"}),
            queued_job(1, labels={"project": "vnl", "arm": "b"}),
            queued_job(2, kind="rollout", policy={"kind": "random"}),
            queued_job(3, environment="hopper", labels={"arm": "b"}),
        ]
        for job in added:
            jobs.add(job)
        jobs.save(cancelled(added[1]))
        page = jobs.list(query)
        assert [job.id for job in page.jobs] == [added[i].id for i in expected]
        assert page.next_cursor is None

    @pytest.mark.parametrize("cursor", ["", "nonsense", "0", "[", "é", "a\0"])
    def test_a_cursor_of_nowhere_is_refused(self, jobs: JobStore, cursor: str) -> None:
        with pytest.raises(Rejected, match="cursor"):
            jobs.list(ANY, cursor=cursor)


class TestNames:
    """The things that jobs name: models, checkpoints of other jobs, objects."""

    def test_unfinished_jobs_borrow_a_checkpoint(self, jobs: JobStore) -> None:
        source = jobs.add(queued_job()).id
        resumed = queued_job(1, resume_from={"job": source, "step": 10})
        policy = {"kind": "checkpoint", "job": source}
        rollout, ended = (queued_job(i, kind="rollout", policy=policy) for i in (2, 3))
        for job in (resumed, rollout, ended):
            jobs.add(job)
        jobs.save(cancelled(ended))
        assert jobs.jobs_needing_checkpoint_of(source) == [(resumed.id, 10), (rollout.id, None)]
        assert jobs.jobs_needing_checkpoint_of(resumed.id) == []

    def test_artifacts_and_chunks_are_named_objects(self, jobs: JobStore) -> None:
        first, second, third = (held(jobs, queued_job(i)) for i in range(3))
        jobs.save(first.with_artifacts((artifact("a"), artifact("b"))))
        say(jobs, second, "x")
        jobs.replace_by_chunk(second.id, chunk_of(jobs.oldest_entries(second.id, "logs", limit=1)))
        jobs.save(third.with_artifacts((artifact("c"),)))
        named = jobs.objects_named([first.id, second.id, new_job_id(NOW)])
        assert set(named) == {"of a", "of b", "chunk"}
        assert set(jobs.objects_named([])) == set()


DESCRIPTION = Description(
    inventory=Inventory(
        joints=[],
        actuators=[],
        sensors=[],
        bodies=["torso"],
        geoms=[],
        cameras=["top"],
        keyframes=[],
        sizes=Sizes(nq=0, nv=0, nu=0, na=0, nbody=2, ngeom=0),
        root="torso",
        has_free_joint=False,
        travels=False,
        initial_height=0.5,
        mass_kg=1.0,
        timestep_s=0.002,
    ),
    engines={"native": None, "mjx": "No."},
    physics_steps_per_second=1000.0,
    settled_height=0.5,
)


class TestModels:
    def test_what_was_added_is_read_back_equal(self, jobs: JobStore) -> None:
        ready = model(description=DESCRIPTION)
        jobs.models.add(ready)
        assert jobs.models.find(MODEL) == ready

    def test_an_unknown_model_is_not_found(self, jobs: JobStore) -> None:
        with pytest.raises(ModelNotFound):
            jobs.models.find(MODEL)

    def test_a_model_that_waits_for_its_validation_is_to_be_dispatched(self, jobs: JobStore) -> None:
        jobs.models.add(model(status="validating"))
        assert jobs.undispatched() == [Dispatch("model", MODEL)]
        jobs.models.dispatched(MODEL)
        assert jobs.undispatched() == []

    def test_a_ready_model_is_not_to_be_dispatched(self, jobs: JobStore) -> None:
        jobs.models.add(model())
        assert (jobs.undispatched(), jobs.waiting()) == ([], [])

    def test_what_was_found_out_is_stored(self, jobs: JobStore) -> None:
        jobs.models.add(model(status="validating"))
        refused = model(status="refused", message="a\0b", refused_at=NOW)
        jobs.models.settle(refused)
        assert jobs.models.find(MODEL) == refused.model_copy(update={"message": "a\ufffdb"})
        assert jobs.waiting() == []

    def test_a_refused_model_that_is_sent_again_waits_again(self, jobs: JobStore) -> None:
        jobs.models.add(model(status="refused", message="No.", refused_at=NOW))
        again = model(status="validating")
        jobs.models.add(again)
        assert jobs.models.find(MODEL) == again
        assert jobs.undispatched() == jobs.waiting() == [Dispatch("model", MODEL)]

    def test_nothing_is_found_out_of_a_model_that_was_deleted(self, jobs: JobStore) -> None:
        jobs.models.add(model(status="validating"))
        jobs.models.delete(MODEL)
        with pytest.raises(ModelNotFound):
            jobs.models.settle(model())
        with pytest.raises(ModelNotFound):
            jobs.models.find(MODEL)
        assert (jobs.undispatched(), jobs.waiting()) == ([], [])
        jobs.models.delete(MODEL)

    def test_one_that_unfinished_jobs_need_is_not_released(self, jobs: JobStore) -> None:
        environment = {"id": "mjcf", "options": {"model": MODEL}}
        first, second, ended = (queued_job(i, environment=environment) for i in range(3))
        for file in (MODEL, other := MODEL.replace("0", "1")):
            jobs.models.add(model(file))
            jobs.models.claim(file, NOBODYS)
        for job in (second, first, ended, queued_job(3)):
            jobs.add(job)
        jobs.save(cancelled(ended))
        with pytest.raises(ModelInUse) as refused:
            jobs.models.release(MODEL, ["default"])
        assert refused.value.facts["jobs"] == [first.id, second.id]
        assert jobs.models.release(other, ["default"])

    def test_all_are_listed_and_one_that_cannot_be_read_is_refused_alone(
        self, jobs: JobStore, database: Database
    ) -> None:
        first, second, third = (model(MODEL.replace("0", digit)) for digit in "123")
        for record in (third, first, second):
            jobs.models.add(record)
        assert jobs.models.all() == [first, second, third]
        database.change("UPDATE models SET description = '{}' WHERE id = %s", second.id)
        with capture_logs() as said:
            assert [record.status for record in jobs.models.all()] == ["ready", "refused", "ready"]
            found = jobs.models.find(second.id)
        assert (found.status, found.description) == ("refused", None)
        assert "send it again" in (found.message or "")
        assert [(entry["event"], entry["upload"]) for entry in said] == [("upload_unreadable", second.id)] * 2


class TestClips:
    """Clip files are kept as models are; here is what they have besides."""

    def test_what_was_added_is_read_back_equal(self, jobs: JobStore) -> None:
        facts = ClipFacts(name="walk", num_frames=3, rate=50.0, seconds=0.04, warnings=["It slides."])
        described = ClipsDescription(format="csv", clips=[facts], joints=["hip"])
        jobs.clips.add(file := clip_file(rate=50.0, description=described))
        assert jobs.clips.find(CLIPS) == file
        with pytest.raises(ModelNotFound):
            jobs.models.find(CLIPS)

    def test_one_that_waits_for_its_validation_is_to_be_dispatched(self, jobs: JobStore) -> None:
        jobs.clips.add(clip_file(status="validating"))
        jobs.models.add(model(status="validating"))
        assert set(jobs.undispatched()) == {Dispatch("clips", CLIPS), Dispatch("model", MODEL)}
        assert set(jobs.waiting()) == set(jobs.undispatched())
        assert (jobs.clips.num_waiting(), jobs.models.num_waiting()) == (1, 1)
        jobs.clips.dispatched(CLIPS)
        assert jobs.undispatched() == [Dispatch("model", MODEL)]

    def test_those_that_a_job_needs_are_not_released_and_those_that_are_gone_not_named(
        self, jobs: JobStore
    ) -> None:
        choices = [{"file": CLIPS}, {"file": CLIPS.replace("c", "d")}, {"file": CLIPS}]
        environment = {"id": "ant", "options": {"reference": {"clips": choices}}}
        for choice in choices:
            jobs.clips.add(clip_file(choice["file"]))
            jobs.clips.claim(choice["file"], NOBODYS)
        jobs.add(job := queued_job(environment=environment))
        for choice in choices:
            with pytest.raises(ClipsInUse, match=job.id):
                jobs.clips.release(choice["file"], ["default"])
        assert not jobs.clips.release(CLIPS, ["another"])
        jobs.save(cancelled(job))
        assert jobs.clips.release(CLIPS, ["default"])
        with pytest.raises(ClipsNotFound):
            jobs.add(later := queued_job(1, environment=environment))
        with pytest.raises(JobNotFound):
            jobs.get(later.id)


class TestUnreadable:
    """A record of another version, or a damaged one, is set aside and keeps no other from being served."""

    @pytest.mark.parametrize(
        "damage",
        [
            {"spec": "not JSON"},
            {"spec": "[]"},
            {"spec": '{"kind": "train"}'},
            {"spec": '{"kind": "distil", "environment": "ant"}'},
            {"spec": '{"kind": "train", "environment": {"id": "ant"}, "seed": "a lot"}'},
            {"reason": "bad_weather"},
        ],
    )
    def test_it_is_listed_among_the_others_and_says_why(
        self, jobs: JobStore, database: Database, damage: dict[str, str]
    ) -> None:
        before, damaged, after = (queued_job(i, name=str(i), labels={"project": "vnl"}) for i in range(3))
        for job in (before, damaged, after):
            jobs.add(job)
        database.damage(damaged, **damage)
        for query in (ANY, JobQuery(labels={"project": "vnl"}), JobQuery(status=JobStatus.QUEUED)):
            newest, unreadable, oldest = jobs.list(query).jobs
            assert (newest, oldest) == (after, before)
            assert isinstance(unreadable, UnreadableJob)
            assert (unreadable.id, unreadable.version, unreadable.status) == (
                damaged.id,
                1,
                JobStatus.QUEUED,
            )
            assert (unreadable.name, unreadable.labels, unreadable.created_at) == (
                "1",
                {"project": "vnl"},
                damaged.created_at,
            )
            assert unreadable.problem
        assert jobs.find(damaged.id) == unreadable
        with pytest.raises(JobUnreadable) as caught:
            jobs.get(damaged.id)
        assert unreadable.problem in caught.value.detail

    def test_it_can_be_deleted(self, jobs: JobStore, database: Database) -> None:
        job = queued_job()
        jobs.add(job)
        database.damage(job, spec="{")
        jobs.delete(job.id, jobs.find(job.id).version)
        with pytest.raises(JobNotFound):
            jobs.find(job.id)

    def test_it_can_be_patched_unless_it_is_damaged(self, jobs: JobStore, database: Database) -> None:
        job = jobs.add(queued_job(name="a"))
        later = '{"kind": "distil", "name": "a", "teacher": {"job": "x"}}'
        database.damage(job, spec=later)
        patched = jobs.patch(job.id, JobPatch(labels={"team": "legs"}, note="It is of a later version."))
        assert isinstance(patched, UnreadableJob)
        assert (patched.name, patched.labels) == ("a", {"team": "legs"})
        assert patched.note == patched.spec["note"] == "It is of a later version."
        assert patched.spec["teacher"] == {"job": "x"}
        database.damage(job, spec="{")
        with pytest.raises(JobUnreadable):
            jobs.patch(job.id, JobPatch(name="b"))
        with pytest.raises(JobNotFound):
            jobs.patch(new_job_id(NOW), JobPatch(name="b"))

    def test_one_of_an_unknown_status_counts_as_running(self, jobs: JobStore, database: Database) -> None:
        job = queued_job()
        jobs.add(job)
        database.damage(job, status="paused")
        assert jobs.find(job.id).status == JobStatus.RUNNING

    def test_it_stops_neither_the_watch_over_leases_nor_dispatches(
        self, jobs: JobStore, database: Database
    ) -> None:
        first, damaged, last = (held(jobs, queued_job(i)) for i in range(3))
        waiting = queued_job(3)
        jobs.add(waiting)
        watch(jobs, database)
        for job in (first, damaged, last):
            database.end_lease(job)
        for job in (damaged, waiting):
            database.damage(job, spec="{")
        with capture_logs() as said:
            assert list(jobs.expired()) == [first, last]
        assert [(entry["event"], entry["job_id"]) for entry in said] == [("job_unreadable", damaged.id)]
        assert jobs.waiting() == jobs.undispatched() == [Dispatch("attempt", waiting.id, 1)]

    def test_a_key_that_made_it_says_so(self, jobs: JobStore, database: Database) -> None:
        job = queued_job()
        jobs.add(job, Idempotency("k", "body"))
        database.damage(job, spec="{")
        with pytest.raises(JobUnreadable):
            jobs.add(queued_job(1), Idempotency("k", "body"))
        with pytest.raises(JobUnreadable):
            jobs.remembered(Idempotency("k", "body"))

    def test_an_unknown_field_in_a_specification_is_passed_over(
        self, jobs: JobStore, database: Database
    ) -> None:
        job = queued_job(algorithm={"kind": "ppo", "num_envs": 64})
        jobs.add(job)
        for path in ("{later}", "{algorithm,later}", "{environment,later}"):
            database.change("UPDATE jobs SET spec = jsonb_set(spec::jsonb, %s, '{\"a\": 1}')", path)
        assert "later" in database.read("SELECT spec FROM jobs")[0][0]
        assert jobs.get(job.id) == job
        jobs.save(claimed := job.claimed("worker-1", NOW))
        assert jobs.get(job.id) == claimed

    def test_damaged_progress_is_no_progress(self, jobs: JobStore, database: Database) -> None:
        job = queued_job()
        jobs.add(job)
        database.damage(job, progress='{"step": "many"}')
        assert jobs.get(job.id).progress == Progress()


class TestWorkers:
    def test_workers_are_known_by_name_until_they_fall_silent(
        self, jobs: JobStore, database: Database
    ) -> None:
        for name in ("b", "a", "c"):
            jobs.announce(worker(name), ttl=LEASE)
        database.change("UPDATE workers SET gone_at = gone_at - %s WHERE name = 'c'", LEASE)
        assert list(jobs.workers()) == [worker("a"), worker("b")]

    def test_a_heartbeat_replaces_the_one_before(self, jobs: JobStore, database: Database) -> None:
        jobs.announce(worker("a"), ttl=LEASE)
        database.change("UPDATE workers SET gone_at = gone_at - %s", LEASE)
        busy = worker("a").model_copy(update={"job": "019aa3c2f0b1-5be0c1d2e3"})
        jobs.announce(busy, ttl=LEASE)
        assert list(jobs.workers()) == [busy]

    def test_a_worker_that_leaves_is_forgotten(self, jobs: JobStore) -> None:
        jobs.announce(worker("a"), ttl=LEASE)
        jobs.withdraw("a")
        jobs.withdraw("never came")
        assert list(jobs.workers()) == []

    def test_one_of_another_version_hides_no_other(self, jobs: JobStore, database: Database) -> None:
        for name in ("a", "b"):
            jobs.announce(worker(name), ttl=LEASE)
        database.change("UPDATE workers SET document = '{\"name\": \"a\"}' WHERE name = 'a'")
        assert list(jobs.workers()) == [worker("b")]


class TestTidying:
    def test_keys_and_workers_whose_time_is_over_are_forgotten_and_no_others(
        self, jobs: JobStore, database: Database
    ) -> None:
        for i, key in enumerate(("old", "new")):
            jobs.add(queued_job(i), Idempotency(key, "body"))
            jobs.announce(worker(key), ttl=LEASE)
            if key == "old":
                database.change("UPDATE idempotency_keys SET forgotten_at = now() - interval '1 s'")
                database.change("UPDATE workers SET gone_at = now() - interval '1 s'")
        jobs.tidy()
        assert database.count("idempotency_keys") == database.count("workers") == 1
        assert list(jobs.workers()) == [worker("new")]
        assert jobs.remembered(Idempotency("new", "body")) is not None
        assert len(jobs.list(ANY).jobs) == 2

    def test_nothing_to_forget_is_no_error(self, jobs: JobStore) -> None:
        jobs.tidy()
        jobs.ping()
