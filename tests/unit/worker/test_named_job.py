"""What a worker does with work that is not ours: nothing."""

from pathlib import Path

import pytest
import redis
import rq
from rq.job import Callback
from rq.serializers import JSONSerializer

from core.adapters.rq import queue as rq_queue
from worker.tasks import NamedJob, UnknownTask


def queue(client: redis.Redis) -> rq.Queue:
    return rq.Queue("gaitway-any-normal", connection=client, serializer=JSONSerializer)


def work(client: redis.Redis) -> None:
    """Do what is in the queue, in this process, with the jobs of our worker."""
    names = ["gaitway-any-normal"]
    rq.SimpleWorker(names, connection=client, serializer=JSONSerializer, job_class=NamedJob).work(burst=True)


@pytest.mark.parametrize("function", ["os.mkdir", "pathlib.Path.mkdir", "worker.tasks.os.mkdir"])
def test_a_function_that_is_no_task_is_not_called(
    function: str, redis_client: redis.Redis, tmp_path: Path
) -> None:
    folder = tmp_path / "made"
    asked = queue(redis_client).enqueue_call(function, args=(str(folder),))
    work(redis_client)
    assert not folder.exists()
    assert asked.get_status() == "failed"


def test_callbacks_are_not_called(
    redis_client: redis.Redis, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    called: list[str] = []
    monkeypatch.setitem(NamedJob.tasks, rq_queue.UPLOAD_TASKS["model"], called.append)
    monkeypatch.setattr("tests.unit.worker.test_named_job.CALLED", called)
    queue(redis_client).enqueue_call(
        rq_queue.UPLOAD_TASKS["model"],
        args=("model",),
        on_success=Callback("tests.unit.worker.test_named_job.call_back"),
        on_failure=Callback("tests.unit.worker.test_named_job.call_back"),
    )
    work(redis_client)
    assert called == ["model"]


def test_a_method_of_a_value_is_no_task(redis_client: redis.Redis) -> None:
    job = NamedJob(id="x", connection=redis_client, serializer=JSONSerializer)
    job._func_name, job._instance, job._args, job._kwargs = rq_queue.TASK, "text", (), {}
    with pytest.raises(UnknownTask):
        _ = job.func


def test_what_the_queue_sends_are_the_tasks_of_the_worker() -> None:
    assert set(NamedJob.tasks) == {rq_queue.TASK, *rq_queue.UPLOAD_TASKS.values(), rq_queue.PREVIEW_TASK}


CALLED: list[str] = []


def call_back(*_: object) -> None:
    CALLED.append("callback")
