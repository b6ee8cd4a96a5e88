"""What every JobStore promises, on each of them."""

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import redis

from core.adapters.connect import connect_redis
from core.adapters.redis_jobs import RedisJobStore
from core.errors import (
    IdempotencyKeyReused,
    JobExists,
    JobNotFound,
    LeaseLost,
    RecordsUnavailable,
    Rejected,
    StaleJob,
)
from core.jobs.job import Job, Progress, new_job_id
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus, Reason
from core.jobs.store import Entry, Idempotency, JobQuery, JobStore, WorkerInfo
from gaitway.embedded.valkey import Valkey

NOW = datetime(2026, 11, 21, 12, 0, 0, tzinfo=UTC)
LEASE = timedelta(seconds=30)
A_MOMENT = timedelta(milliseconds=50)
ANY = JobQuery()


def queued_job(at_s: int = 0, **said: object) -> Job:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **said})
    created_at = NOW + timedelta(seconds=at_s)
    return Job(id=new_job_id(created_at), spec=spec, created_at=created_at)


def held(jobs: JobStore, job: Job, lease: timedelta = LEASE) -> Job:
    """The job in `jobs`, held by its first attempt."""
    jobs.add(job)
    claimed = job.claimed("worker-1", NOW)
    jobs.save(claimed, lease=lease)
    return claimed


def line(text: str) -> Entry:
    return Entry(kind="line", time=NOW, data={"text": text})


def texts(entries: object) -> list[str]:
    return [entry.data["text"] for entry in entries]  # type: ignore[attr-defined]


class TestJobs:
    def test_what_was_added_is_read_back_equal(self, jobs: JobStore) -> None:
        job = queued_job(name="erste Schritte – 初めて 🐜", labels={"project": "vnl"}, seed=7)
        assert jobs.add(job) == job
        assert jobs.get(job.id) == job

    def test_an_unknown_job_is_not_found(self, jobs: JobStore) -> None:
        with pytest.raises(JobNotFound):
            jobs.get(new_job_id(NOW))

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
            jobs.save(job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", NOW))
        assert jobs.get(job.id) == claimed
        assert len(jobs.feed(job.id, "events")) == 1

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
        together = threading.Barrier(8)

        def claim(number: int) -> bool:
            together.wait()
            try:
                jobs.save(job.claimed(f"worker-{number}", NOW), lease=LEASE)
            except StaleJob:
                return False
            return True

        with ThreadPoolExecutor(8) as pool:
            won = list(pool.map(claim, range(8)))
        assert won.count(True) == 1
        assert jobs.get(job.id).attempts[0].worker == f"worker-{won.index(True)}"

    def test_a_change_of_status_is_told_in_the_events(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        running = claimed.running(device="cpu")
        jobs.save(running)
        jobs.save(running.next(message="no new status"))
        jobs.save(running.next().ended(JobStatus.FAILED, Reason.DIVERGED, "NaN at 7", NOW))
        assert [entry.data for entry in jobs.feed(claimed.id, "events", kind="status")] == [
            {"status": "starting", "reason": None, "message": None, "attempt": 1},
            {"status": "running", "reason": None, "message": None, "attempt": 1},
            {"status": "failed", "reason": "diverged", "message": "NaN at 7", "attempt": 1},
        ]

    def test_a_deleted_job_leaves_nothing(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.record(claimed.id, claimed.token, "logs", [line("a")])
        jobs.delete(claimed)
        with pytest.raises(JobNotFound):
            jobs.get(claimed.id)
        with pytest.raises(JobNotFound):
            jobs.feed(claimed.id, "logs")
        assert not jobs.lease_is_alive(claimed.id)
        assert (list(jobs.list(ANY).jobs), list(jobs.unfinished())) == ([], [])

    def test_deleting_an_older_version_is_refused(self, jobs: JobStore) -> None:
        job = queued_job()
        claimed = held(jobs, job)
        with pytest.raises(StaleJob):
            jobs.delete(job)
        assert jobs.get(job.id) == claimed

    def test_deleting_an_unknown_job_is_not_found(self, jobs: JobStore) -> None:
        with pytest.raises(JobNotFound):
            jobs.delete(queued_job())

    def test_unfinished_jobs_come_oldest_first(self, jobs: JobStore) -> None:
        first, second, third = queued_job(0), queued_job(1), queued_job(2)
        for job in (third, first, second):
            jobs.add(job)
        jobs.save(second.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", NOW))
        assert list(jobs.unfinished()) == [first, third]

    def test_a_requeued_job_is_unfinished(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        requeued = claimed.requeued(Reason.WORKER_LOST, "", NOW)
        jobs.save(requeued)
        assert list(jobs.unfinished()) == [requeued]

    def test_a_finished_job_can_be_added(self, jobs: JobStore) -> None:
        ended = queued_job().ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", NOW)
        jobs.add(ended)
        assert jobs.get(ended.id) == ended
        assert list(jobs.unfinished()) == []


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

    @pytest.mark.parametrize("key", ["é ü 日本", "a\0b", "k" * 10_000, ":*?"])
    def test_any_text_is_a_key(self, jobs: JobStore, key: str) -> None:
        job = queued_job()
        jobs.add(job, Idempotency(key, "body"))
        assert jobs.remembered(Idempotency(key, "body")) == job

    def test_the_key_of_a_deleted_job_is_free(self, jobs: JobStore) -> None:
        job, another = queued_job(0), queued_job(1)
        jobs.add(job, Idempotency("k", "body"))
        jobs.delete(job)
        assert jobs.remembered(Idempotency("k", "body")) is None
        assert jobs.add(another, Idempotency("k", "body")) == another

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
        got: list[Job] = []
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
        jobs.delete(c)
        assert list(jobs.list(ANY, cursor=page.next_cursor).jobs) == [b, a]

    def test_more_jobs_than_one_look_at_the_index(self, jobs: JobStore) -> None:
        # Redis' adapter reads the index 200 at a time: the only match lies in the second piece.
        added = [queued_job(i, name="it" if i == 3 else None) for i in range(230)]
        for job in added:
            jobs.add(job)
        assert list(jobs.list(JobQuery(name="it")).jobs) == [added[3]]
        assert [job.id for job in jobs.list(ANY, limit=300).jobs] == [job.id for job in added[::-1]]

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
        jobs.save(added[1].ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", NOW))
        page = jobs.list(query)
        assert [job.id for job in page.jobs] == [added[i].id for i in expected]
        assert page.next_cursor is None

    @pytest.mark.parametrize("cursor", ["", "nonsense", "0", "[", "é"])
    def test_a_cursor_of_nowhere_is_refused(self, jobs: JobStore, cursor: str) -> None:
        with pytest.raises(Rejected, match="cursor"):
            jobs.list(ANY, cursor=cursor)


class TestLeases:
    def test_a_claim_starts_a_lease(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        assert jobs.lease_is_alive(claimed.id)

    def test_a_queued_job_has_no_lease(self, jobs: JobStore) -> None:
        job = queued_job()
        jobs.add(job)
        assert not jobs.lease_is_alive(job.id)
        assert not jobs.lease_is_alive(new_job_id(NOW))

    def test_a_lease_not_renewed_ends(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job(), lease=A_MOMENT)
        threading.Event().wait(0.08)
        assert not jobs.lease_is_alive(claimed.id)

    def test_a_renewed_lease_goes_on(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job(), lease=A_MOMENT)
        assert jobs.renew(claimed.id, claimed.token, LEASE) == JobStatus.STARTING
        threading.Event().wait(0.08)
        assert jobs.lease_is_alive(claimed.id)

    def test_a_lease_that_ended_is_renewed_while_nobody_took_the_job(self, jobs: JobStore) -> None:
        # After an outage of the store the attempt that went on working is still the one that holds the job.
        claimed = held(jobs, queued_job(), lease=timedelta(milliseconds=1))
        threading.Event().wait(0.01)
        jobs.renew(claimed.id, claimed.token, LEASE)
        assert jobs.lease_is_alive(claimed.id)

    def test_renewing_tells_of_a_cancel(self, jobs: JobStore) -> None:
        running = held(jobs, queued_job()).running()
        jobs.save(running)
        jobs.save(running.become(JobStatus.CANCELLING))
        assert jobs.renew(running.id, running.token, LEASE) == JobStatus.CANCELLING
        assert jobs.lease_is_alive(running.id)

    @pytest.mark.parametrize("token", ["", "1-0000000000000000"])
    def test_another_token_renews_nothing(self, jobs: JobStore, token: str) -> None:
        claimed = held(jobs, queued_job(), lease=A_MOMENT)
        with pytest.raises(LeaseLost):
            jobs.renew(claimed.id, token, LEASE)
        threading.Event().wait(0.08)
        assert not jobs.lease_is_alive(claimed.id)

    @pytest.mark.parametrize("token", ["", "1-0000000000000000"])
    def test_nobody_renews_a_job_that_nobody_holds(self, jobs: JobStore, token: str) -> None:
        job = queued_job()
        jobs.add(job)
        with pytest.raises(LeaseLost):
            jobs.renew(job.id, token, LEASE)
        with pytest.raises(LeaseLost):
            jobs.renew(new_job_id(NOW), token, LEASE)

    def test_a_job_that_left_its_attempt_has_no_lease(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        requeued = claimed.requeued(Reason.WORKER_LOST, "", NOW)
        jobs.save(requeued)
        assert not jobs.lease_is_alive(claimed.id)
        with pytest.raises(LeaseLost):
            jobs.renew(claimed.id, claimed.token, LEASE)

    def test_the_lease_of_one_attempt_is_not_the_next_ones(self, jobs: JobStore) -> None:
        requeued = held(jobs, queued_job()).requeued(Reason.WORKER_LOST, "", NOW)
        jobs.save(requeued)
        jobs.save(requeued.claimed("worker-2", NOW))
        assert not jobs.lease_is_alive(requeued.id)


class TestFeeds:
    def test_entries_come_back_in_order_with_rising_ids(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.record(claimed.id, claimed.token, "logs", [line("a"), line("é\n\0🐜")])
        jobs.record(claimed.id, claimed.token, "logs", [line("c")])
        entries = jobs.feed(claimed.id, "logs")
        assert texts(entries) == ["a", "é\n\0🐜", "c"]
        assert (entries[0].kind, entries[0].time) == ("line", NOW)
        assert len({entry.id for entry in entries}) == 3
        assert all(entry.id and " " not in entry.id for entry in entries)

    def test_reading_goes_on_after_an_id(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.record(claimed.id, claimed.token, "logs", [line(str(i)) for i in range(25)])
        got: list[str] = []
        after = ""
        while entries := jobs.feed(claimed.id, "logs", after=after, limit=10):
            assert len(entries) <= 10
            got += texts(entries)
            after = entries[-1].id
        assert got == [str(i) for i in range(25)]

    def test_channels_are_apart(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.record(claimed.id, claimed.token, "logs", [line("a")])
        assert [entry.kind for entry in jobs.feed(claimed.id, "events")] == ["status"]

    def test_one_kind_is_found_among_many_others(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        said = [
            Entry(kind="metrics" if i % 150 == 149 else "phase", time=NOW, data={"i": i}) for i in range(600)
        ]
        jobs.record(claimed.id, claimed.token, "events", said)
        first = jobs.feed(claimed.id, "events", kind="metrics", limit=3)
        assert [entry.data["i"] for entry in first] == [149, 299, 449]
        rest = jobs.feed(claimed.id, "events", kind="metrics", after=first[-1].id, limit=3)
        assert [entry.data["i"] for entry in rest] == [599]

    def test_a_new_job_has_an_empty_feed(self, jobs: JobStore) -> None:
        job = queued_job()
        jobs.add(job)
        assert list(jobs.feed(job.id, "events")) == []

    def test_the_feed_of_an_unknown_job_is_not_found(self, jobs: JobStore) -> None:
        with pytest.raises(JobNotFound):
            jobs.feed(new_job_id(NOW), "events")

    @pytest.mark.parametrize("after", ["x", "1", "-", "1-2-3", "9" * 40 + "-0"])
    def test_an_id_of_nowhere_is_refused(self, jobs: JobStore, after: str) -> None:
        job = queued_job()
        jobs.add(job)
        with pytest.raises(Rejected):
            jobs.feed(job.id, "events", after=after)

    def test_progress_is_read_with_the_job_and_survives_saves(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        progress = Progress(step=10, total=100, steps_per_second=5.0, metrics={"episode_reward": 1.5})
        jobs.record(claimed.id, claimed.token, "events", [], progress)
        jobs.save(claimed.running(device="cpu"))
        assert jobs.get(claimed.id).progress == progress
        assert jobs.list(ANY).jobs[0].progress == progress

    def test_a_save_does_not_write_progress(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.save(claimed.running().model_copy(update={"progress": Progress(step=999)}))
        assert jobs.get(claimed.id).progress == Progress()

    def test_progress_moves_no_version(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.record(claimed.id, claimed.token, "events", [], Progress(step=1))
        jobs.save(claimed.running())
        assert jobs.get(claimed.id).version == claimed.version + 1

    @pytest.mark.parametrize("token", ["", "1-0000000000000000"])
    def test_a_stale_token_writes_nothing(self, jobs: JobStore, token: str) -> None:
        claimed = held(jobs, queued_job())
        with pytest.raises(LeaseLost):
            jobs.record(claimed.id, token, "events", [line("a")], Progress(step=5))
        assert [entry.kind for entry in jobs.feed(claimed.id, "events")] == ["status"]
        assert jobs.get(claimed.id).progress == Progress()

    def test_an_attempt_that_lost_its_job_writes_nothing(self, jobs: JobStore) -> None:
        lost = held(jobs, queued_job())
        requeued = lost.requeued(Reason.WORKER_LOST, "", NOW)
        jobs.save(requeued)
        jobs.save(requeued.claimed("worker-2", NOW), lease=LEASE)
        with pytest.raises(LeaseLost):
            jobs.record(lost.id, lost.token, "logs", [line("late")], Progress(step=5))
        assert list(jobs.feed(lost.id, "logs")) == []

    def test_an_ended_job_takes_no_entries(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.save(claimed.ended(JobStatus.FAILED, Reason.DIVERGED, "", NOW))
        with pytest.raises(LeaseLost):
            jobs.record(claimed.id, claimed.token, "logs", [line("late")])
        with pytest.raises(LeaseLost):
            jobs.record(new_job_id(NOW), claimed.token, "logs", [line("late")])

    def test_waiting_ends_when_an_entry_comes(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        newest = jobs.feed(claimed.id, "events")[-1].id
        with ThreadPoolExecutor(1) as pool:
            waiting = pool.submit(
                jobs.wait, claimed.id, "events", after=newest, timeout=timedelta(seconds=30)
            )
            jobs.save(claimed.running())
            assert waiting.result(timeout=5) is True

    def test_waiting_for_what_is_there_ends_at_once(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        assert jobs.wait(claimed.id, "events", timeout=timedelta(seconds=30)) is True

    @pytest.mark.parametrize("timeout_s", [0.0, 0.02])
    def test_waiting_in_vain_says_so(self, jobs: JobStore, timeout_s: float) -> None:
        claimed = held(jobs, queued_job())
        newest = jobs.feed(claimed.id, "events")[-1].id
        assert jobs.wait(claimed.id, "events", after=newest, timeout=timedelta(seconds=timeout_s)) is False


class TestWorkers:
    def test_workers_are_known_by_name_until_they_fall_silent(self, jobs: JobStore) -> None:
        for name in ("b", "a"):
            jobs.announce(worker(name), ttl=LEASE)
        jobs.announce(worker("c"), ttl=timedelta(milliseconds=1))
        threading.Event().wait(0.01)
        assert list(jobs.workers()) == [worker("a"), worker("b")]

    def test_a_heartbeat_replaces_the_one_before(self, jobs: JobStore) -> None:
        jobs.announce(worker("a"), ttl=LEASE)
        busy = worker("a").model_copy(update={"job": "019aa3c2f0b1-5be0c1d2e3"})
        jobs.announce(busy, ttl=LEASE)
        assert list(jobs.workers()) == [busy]

    def test_a_worker_that_leaves_is_forgotten(self, jobs: JobStore) -> None:
        jobs.announce(worker("a"), ttl=LEASE)
        jobs.withdraw("a")
        jobs.withdraw("never came")
        assert list(jobs.workers()) == []


def worker(name: str) -> WorkerInfo:
    return WorkerInfo(name=name, host="h", pid=1, device="cpu", started_at=NOW, seen_at=NOW)


class TestRedis:
    """What only a store behind a network can get wrong."""

    def test_an_answer_that_was_lost_does_not_double_the_write(self, redis_client: redis.Redis) -> None:
        jobs = RedisJobStore(redis_client)
        job = queued_job()
        for script in ("_add", "_save", "_record"):
            _send_twice(jobs, script)
        jobs.add(job)
        claimed = job.claimed("worker-1", NOW)
        jobs.save(claimed, lease=LEASE)
        jobs.record(job.id, claimed.token, "logs", [line("once")])
        assert jobs.get(job.id) == claimed
        assert len(jobs.feed(job.id, "events")) == 1
        assert texts(jobs.feed(job.id, "logs")) == ["once"]

    def test_every_call_says_within_seconds_that_the_store_is_gone(self, tmp_path: Path) -> None:
        with Valkey(tmp_path) as server, connect_redis(server.url) as client:
            jobs = RedisJobStore(client)
            claimed = held(jobs, queued_job())
            server.stop()
            calls = [
                lambda: jobs.add(queued_job()),
                lambda: jobs.remembered(Idempotency("k", "b")),
                lambda: jobs.get(claimed.id),
                lambda: jobs.save(claimed.running()),
                lambda: jobs.delete(claimed),
                lambda: jobs.list(ANY),
                jobs.unfinished,
                lambda: jobs.renew(claimed.id, claimed.token, LEASE),
                lambda: jobs.lease_is_alive(claimed.id),
                lambda: jobs.record(claimed.id, claimed.token, "logs", [line("a")]),
                lambda: jobs.feed(claimed.id, "logs"),
                lambda: jobs.wait(claimed.id, "logs", timeout=LEASE),
                lambda: jobs.announce(worker("a"), LEASE),
                lambda: jobs.withdraw("a"),
                jobs.workers,
                jobs.ping,
            ]
            for call in calls:
                with pytest.raises(RecordsUnavailable, match="GAITWAY_REDIS_URL"):
                    call()

    def test_it_goes_on_when_the_store_is_back(self, tmp_path: Path) -> None:
        with Valkey(tmp_path) as server, connect_redis(server.url) as client:
            jobs = RedisJobStore(client)
            job = queued_job()
            jobs.add(job)
            server.stop()
            server.launch().wait_ready()
            assert jobs.get(job.id) == job

    def test_a_server_that_refuses_writes_is_unavailable(self, redis_client: redis.Redis) -> None:
        redis_client.config_set("maxmemory", "1")
        try:
            with pytest.raises(RecordsUnavailable):
                RedisJobStore(redis_client).add(queued_job())
        finally:
            redis_client.config_set("maxmemory", "0")


def _send_twice(jobs: RedisJobStore, name: str) -> None:
    """Let the script run twice at every call, as a client does that lost the answer."""
    script = getattr(jobs, name)

    def twice(**sent: object) -> object:
        script(**sent)
        return script(**sent)

    setattr(jobs, name, twice)
