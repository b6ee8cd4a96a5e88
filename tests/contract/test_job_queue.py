"""What every JobQueue promises, on each of them; and that RQ's workers get what was enqueued."""

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import redis
from rq import Queue, SimpleWorker
from rq.job import Job as RQJob
from rq.serializers import JSONSerializer

from core.adapters.rq.queue import PREVIEW_TASK, TASK, UPLOAD_TASKS, RQQueue, job_of
from core.adapters.wiring import connect_redis
from core.errors import RecordsUnavailable
from core.jobs.queue import JobQueue, queue_name, queue_names
from core.jobs.reconciliation import StrayMessages
from core.previews.record import PreviewRequest
from gaitway.service.embedded.valkey import Valkey
from tests.in_memory import Dispatch, MemoryJobQueue

JOB = "019aa3c2f0b1-5be0c1d2e3"
MODEL = "sha256:" + "0" * 64
PREVIEW = PreviewRequest(environment="ant", options={}, cameras=["track"], width=64, height=48)
OTHER = "019aa3c2f0b2-5be0c1d2e3"


def enqueue(queue: JobQueue, job_id: str = JOB, attempt: int = 1) -> None:
    queue.enqueue(job_id, attempt, name=queue_name("any", "normal"))


class TestEveryQueue:
    def test_what_was_enqueued_is_contained(self, queue: JobQueue) -> None:
        enqueue(queue)
        assert queue.contains(JOB, 1)
        assert not queue.contains(JOB, 2)
        assert not queue.contains(OTHER, 1)

    def test_what_was_removed_is_gone_and_can_come_again(self, queue: JobQueue) -> None:
        enqueue(queue)
        queue.remove(JOB, 1)
        assert not queue.contains(JOB, 1)
        enqueue(queue)
        assert queue.contains(JOB, 1)

    def test_removing_what_is_not_there_is_no_error(self, queue: JobQueue) -> None:
        enqueue(queue, OTHER)
        queue.remove(JOB, 1)
        assert queue.contains(OTHER, 1)

    def test_what_is_known_is_told_in_one_look(self, queue: JobQueue) -> None:
        assert set(queue.known()) == set()
        for number in (1, 2):
            queue.enqueue(JOB, number, name=queue_name("any", "normal"))
        queue.enqueue(OTHER, 1, name=queue_name("gpu", "high", 2))
        queue.enqueue_upload("model", "sha256:00")
        assert set(queue.known()) == {(JOB, 1), (JOB, 2), (OTHER, 1)}
        queue.remove(JOB, 1)
        assert set(queue.known()) == {(JOB, 2), (OTHER, 1)}

    def test_removing_one_attempt_leaves_the_others(self, queue: JobQueue) -> None:
        enqueue(queue, JOB, 1)
        enqueue(queue, JOB, 2)
        queue.remove(JOB, 1)
        assert queue.contains(JOB, 2)

    def test_what_waits_in_each_queue_is_counted(self, queue: JobQueue) -> None:
        names = ["gaitway-any-normal", "gaitway-gpu2-high"]
        assert queue.num_waiting(names) == dict.fromkeys(names, 0)
        enqueue(queue, JOB, 1)
        enqueue(queue, OTHER, 1)
        queue.enqueue(JOB, 2, name=queue_name("gpu", "high", 2))
        assert queue.num_waiting(names) == {names[0]: 2, names[1]: 1}

    def test_a_model_that_was_enqueued_is_contained_and_no_job(self, queue: JobQueue) -> None:
        queue.enqueue_upload("model", MODEL)
        queue.enqueue_upload("model", MODEL)
        assert queue.contains_upload("model", MODEL)
        assert not queue.contains_upload("model", MODEL.replace("0", "1"))
        assert not queue.contains(JOB, 1)

    def test_a_preview_that_was_enqueued_waits_once(self, queue: JobQueue) -> None:
        assert (queue.contains_preview(PREVIEW.id), queue.num_previews()) == (False, 0)
        queue.enqueue_preview(PREVIEW)
        queue.enqueue_preview(PREVIEW)
        queue.enqueue_upload("model", MODEL)
        assert (queue.contains_preview(PREVIEW.id), queue.num_previews()) == (True, 1)


class TestMemory:
    def test_workers_take_the_most_urgent_that_fits_once(self) -> None:
        queue = MemoryJobQueue()
        queue.enqueue(JOB, 1, name=queue_name("any", "low"))
        queue.enqueue(JOB, 2, name=queue_name("gpu", "high"))
        queue.enqueue(JOB, 3, name=queue_name("cpu", "normal"))
        enqueue(queue, JOB, 3)
        assert [dispatch.attempt for dispatch in queue.waiting()] == [1, 2, 3]
        assert [queue.take("cpu"), queue.take("cpu")] == [Dispatch(JOB, 3), Dispatch(JOB, 1)]
        assert queue.take("cpu") is None
        assert queue.contains(JOB, 3)
        assert queue.take("gpu:0") == Dispatch(JOB, 2)

    def test_so_many_gpus_as_were_asked_for_take_the_job(self) -> None:
        queue = MemoryJobQueue()
        queue.enqueue(JOB, 1, name=queue_name("gpu", "normal", 2))
        enqueue(queue, JOB, 2)
        assert queue.take("gpu:0,1,2") is None
        assert queue.take("gpu:0,1") == Dispatch(JOB, 1)
        assert queue.take("gpu:0,1") is None
        assert queue.take("gpu:0") == Dispatch(JOB, 2)


class TestRQ:
    def test_a_worker_finds_the_function_the_job_and_the_attempt(self, redis_client: redis.Redis) -> None:
        RQQueue(redis_client).enqueue(JOB, 3, name=queue_name("gpu", "high"))
        (rq_job,) = waiting(redis_client, "gaitway-gpu-high")
        assert (rq_job.func_name, tuple(rq_job.args)) == (TASK, (JOB, 3))
        # RQ must neither stop the job, nor keep its result, nor start a second copy of it.
        assert (rq_job.timeout, rq_job.result_ttl, rq_job.retries_left) == (-1, 0, None)

    def test_a_worker_finds_the_model_before_all_jobs(self, redis_client: redis.Redis) -> None:
        RQQueue(redis_client).enqueue_upload("model", MODEL)
        (rq_job,) = waiting(redis_client, queue_names("cpu")[1])
        assert queue_names("gpu:0")[1] == queue_names("cpu")[1]
        assert (rq_job.func_name, tuple(rq_job.args)) == (UPLOAD_TASKS["model"], (MODEL,))
        assert job_of(rq_job.id) is None

    def test_a_worker_finds_the_whole_request_for_a_preview(self, redis_client: redis.Redis) -> None:
        RQQueue(redis_client).enqueue_preview(PREVIEW)
        (rq_job,) = waiting(redis_client, queue_names("cpu")[0])
        assert rq_job.func_name == PREVIEW_TASK
        assert PreviewRequest.model_validate_json(rq_job.args[0]) == PREVIEW
        assert job_of(rq_job.id) is None

    def test_every_queue_is_served_by_some_worker(self, redis_client: redis.Redis) -> None:
        served = {*queue_names("cpu"), *queue_names("gpu:0")}
        queue = RQQueue(redis_client)
        for accelerator in ("any", "cpu", "gpu"):
            for priority in ("high", "normal", "low"):
                queue.enqueue(
                    JOB, len(waiting_everywhere(redis_client)), name=queue_name(accelerator, priority)
                )
        queue.enqueue_upload("model", MODEL)
        assert {found.name for found in Queue.all(connection=redis_client)} <= served
        assert sum(len(waiting(redis_client, name)) for name in served) == 10

    def test_a_worker_with_two_gpus_takes_what_asks_for_two_and_nobody_else_does(
        self, redis_client: redis.Redis
    ) -> None:
        RQQueue(redis_client).enqueue(JOB, 1, name=queue_name("gpu", "low", 2))
        assert [len(waiting(redis_client, name)) for name in queue_names("gpu:2,3")] == [0, 0, 1]
        assert waiting_everywhere(redis_client) == []

    def test_the_same_attempt_twice_waits_once(self, redis_client: redis.Redis) -> None:
        queue = RQQueue(redis_client)
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(lambda _: enqueue(queue), range(8)))
        assert len(waiting_everywhere(redis_client)) == 1

    def test_those_who_enqueue_a_lost_message_again_at_the_same_time_do_not_fail(
        self, redis_client: redis.Redis
    ) -> None:
        queue = RQQueue(redis_client)
        with ThreadPoolExecutor(4) as pool:
            for _ in range(10):
                enqueue(queue)
                redis_client.delete("rq:queue:gaitway-any-normal")  # A worker took it, and died.
                list(pool.map(lambda _: enqueue(queue), range(4)))
                assert queue.contains(JOB, 1)

    @pytest.mark.parametrize(
        ("field", "content"),
        [
            ("status", "no status"),
            ("created_at", b"\xff"),
            ("timeout", "soon"),
            ("dependency_ids", "[" * 100_000),
            ("group_id", "nobody's"),
        ],
    )
    def test_a_damaged_message_is_replaced(
        self, redis_client: redis.Redis, field: str, content: str | bytes
    ) -> None:
        queue = RQQueue(redis_client)
        enqueue(queue)
        redis_client.delete("rq:queue:gaitway-any-normal")
        redis_client.hset(f"rq:job:{JOB}_1", field, content)
        assert not queue.contains(JOB, 1)
        enqueue(queue)
        assert queue.contains(JOB, 1)

    def test_messages_of_other_programs_are_passed_over(self, redis_client: redis.Redis) -> None:
        queue = RQQueue(redis_client)
        enqueue(queue)
        redis_client.rpush("rq:queue:gaitway-any-normal", "send_mail", b"\xff", "7")
        assert queue.known() == {(JOB, 1)}

    def test_a_message_that_nobody_has_is_a_stray_and_can_be_dropped(self, redis_client: redis.Redis) -> None:
        queue = RQQueue(redis_client)
        enqueue(queue)
        queue.enqueue_upload("model", MODEL)
        queue.enqueue_preview(PREVIEW)
        assert queue.strays() == set()
        redis_client.lpop("rq:queue:gaitway-any-normal")  # what a worker does, that then dies
        [stray] = queue.strays()
        assert job_of(stray) == JOB
        strays = StrayMessages(queue)
        assert [strays.run_once(), strays.run_once()] == [
            0,
            1,
        ]  # At the first look somebody may be taking it.
        assert [key for key in redis_client.keys("*") if stray.encode() in key] == []
        assert queue.contains_upload("model", MODEL)
        assert queue.contains_preview(PREVIEW.id)

    def test_a_message_that_rq_forgets_by_itself_is_no_stray(self, redis_client: redis.Redis) -> None:
        queue = RQQueue(redis_client)
        enqueue(queue)
        redis_client.lpop("rq:queue:gaitway-any-normal")
        [stray] = queue.strays()
        redis_client.expire(f"rq:job:{stray}", 60)
        assert queue.strays() == set()

    def test_an_attempt_whose_worker_died_before_it_started_is_enqueued_again(
        self, redis_client: redis.Redis
    ) -> None:
        queue = RQQueue(redis_client)
        enqueue(queue)
        redis_client.lpop("rq:queue:gaitway-any-normal")  # what a worker does, that then dies
        assert not queue.contains(JOB, 1)
        enqueue(queue)
        assert len(waiting(redis_client, "gaitway-any-normal")) == 1

    @pytest.mark.parametrize("left", [{}, {"last_heartbeat": "1.0"}], ids=["nothing", "half"])
    def test_an_attempt_whose_execution_just_ended_is_removed_and_enqueued_again(
        self, redis_client: redis.Redis, left: dict[str, str]
    ) -> None:
        queue = RQQueue(redis_client)
        enqueue(queue)
        redis_client.lpop("rq:queue:gaitway-any-normal")
        redis_client.zadd(f"rq:executions:{JOB}_1", {"its-execution": "inf"})
        if left:  # A heartbeat that came after the end.
            redis_client.hset(f"rq:execution:{JOB}_1:its-execution", mapping=left)
        queue.remove(JOB, 1)
        assert not queue.contains(JOB, 1)
        enqueue(queue)
        assert queue.contains(JOB, 1)

    def test_while_a_worker_runs_it_an_attempt_is_contained(
        self, redis_client: redis.Redis, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        queue = RQQueue(redis_client)
        monkeypatch.setattr("core.adapters.rq.queue.TASK", "tests.contract.test_job_queue.look")
        enqueue(queue)
        monkeypatch.setattr(f"{__name__}.seen_from", queue)
        work(redis_client)
        assert seen == [(JOB, 1, True)]
        assert not queue.contains(JOB, 1)

    def test_an_attempt_that_failed_can_be_enqueued_again(
        self, redis_client: redis.Redis, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        queue = RQQueue(redis_client)
        monkeypatch.setattr("core.adapters.rq.queue.TASK", "tests.contract.test_job_queue.no_such_function")
        enqueue(queue)
        work(redis_client)
        assert not queue.contains(JOB, 1)
        enqueue(queue)
        assert queue.contains(JOB, 1)

    def test_every_call_says_that_the_queue_is_gone(self, tmp_path: Path) -> None:
        with Valkey(tmp_path) as server, connect_redis(server.url) as client:
            queue = RQQueue(client)
            enqueue(queue)
            server.stop()
            with pytest.raises(RecordsUnavailable):
                enqueue(queue)
            with pytest.raises(RecordsUnavailable):
                queue.contains(JOB, 1)
            with pytest.raises(RecordsUnavailable):
                queue.remove(JOB, 1)


seen: list[tuple[str, int, bool]] = []
seen_from: JobQueue | None = None


def look(job_id: str, attempt: int) -> None:
    """A task: note whether the queue contains what it is part of."""
    assert seen_from is not None
    known = seen_from.contains(job_id, attempt) and (job_id, attempt) in seen_from.known()
    seen.append((job_id, attempt, known))


def work(client: redis.Redis) -> None:
    """Let one of RQ's workers do what waits, in this process."""
    seen.clear()
    assert threading.current_thread() is threading.main_thread()
    worker = SimpleWorker(["gaitway-any-normal"], connection=client, serializer=JSONSerializer)
    worker.work(burst=True, logging_level="CRITICAL")


def waiting(client: redis.Redis, name: str) -> list[RQJob]:
    return Queue(name, connection=client, serializer=JSONSerializer).jobs


def waiting_everywhere(client: redis.Redis) -> list[RQJob]:
    names = {*queue_names("cpu"), *queue_names("gpu:0")}
    return [job for name in names for job in waiting(client, name)]
