"""Imports that are repeated, meet, or lose a store: one job comes of them, and nothing is left over."""

import threading
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

from core.errors import RecordsUnavailable, StorageUnavailable
from core.jobs import feeds
from core.jobs.orphans import sweep
from core.jobs.store import JobQuery
from core.storage import keys
from tests.api.conftest import ARTIFACT, Stack
from tests.api.exports import bring, changed, edit
from tests.api.problems import problem
from tests.in_memory import MemoryObjectStore


def test_a_key_makes_one_job_of_several_requests(stack: Stack, exported: bytes) -> None:
    key = {"Idempotency-Key": "once"}
    first, second = (bring(stack.http, exported, **key) for _ in range(2))
    assert first.status_code == second.status_code == 201
    assert first.json() == second.json()
    assert len(stack.store.list(JobQuery()).jobs) == 1
    other = changed(exported, edit("job.json", spec__name="other"))
    problem(bring(stack.http, other, **key), 409, "idempotency-key-reused")
    assert bring(stack.http, exported).json()["id"] != first.json()["id"]


def test_two_imports_with_one_key_at_the_same_time_make_one_job(
    stack: Stack, exported: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both find the key unknown, then store their files."""
    both = threading.Barrier(2)
    put_stream = stack.objects.put_stream

    def meeting(*what: Any, **how: Any) -> None:
        put_stream(*what, **how)
        both.wait(20)

    monkeypatch.setattr(stack.objects, "put_stream", meeting)
    answers = list[httpx.Response]()

    def send_it() -> None:
        answers.append(bring(stack.http, exported, **{"Idempotency-Key": "once"}))

    threads = [threading.Thread(target=send_it) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    first, second = (answer.json() for answer in answers)
    assert first == second
    own = keys.job(first["id"])
    assert all(info.key.startswith(own) for info in stack.objects.list("jobs/"))


def test_a_store_that_fails_in_the_middle_is_told_and_what_it_has_is_removed(
    stack: Stack, exported: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    put_stream, calls = stack.objects.put_stream, list[str]()

    def failing(key: str, *what: Any, **how: Any) -> None:
        calls.append(key)
        if len(calls) == 3:
            raise StorageUnavailable("The object store does not answer.")
        put_stream(key, *what, **how)

    monkeypatch.setattr(stack.objects, "put_stream", failing)
    problem(bring(stack.http, exported), 503, "storage-unavailable")
    assert len(calls) == 3
    assert stack.is_empty()
    assert bring(stack.http, exported).status_code == 201


@pytest.mark.parametrize("is_stored", [False, True])
def test_a_lost_answer_of_the_record_loses_nothing_and_the_sweep_finds_the_rest(
    stack: Stack, exported: bytes, monkeypatch: pytest.MonkeyPatch, is_stored: bool
) -> None:
    """Nobody can tell whether the record is there, so the files stay; a retry with the key decides."""
    import_job = stack.store.import_job

    def unanswered(*what: Any, **how: Any) -> bool:
        if is_stored:
            import_job(*what, **how)
        raise RecordsUnavailable("PostgreSQL does not answer.")

    yesterday = datetime.now(UTC) - timedelta(hours=25)
    objects = MemoryObjectStore(clock=lambda: yesterday)
    monkeypatch.setattr(stack.service, "objects", objects)
    with monkeypatch.context() as patch:
        patch.setattr(stack.store, "import_job", unanswered)
        problem(bring(stack.http, exported, **{"Idempotency-Key": "k"}), 503, "records-unavailable")
    left = [info.key for info in objects.list("")]
    assert len(left) == 6  # Four files, the metrics and the log.
    answer = bring(stack.http, exported, **{"Idempotency-Key": "k"})
    assert answer.status_code == 201
    own = keys.job(answer.json()["id"])
    for _ in sweep(store=stack.store, objects=objects):
        pass
    kept = [info.key for info in objects.list("")]
    assert len(kept) == 6
    assert all(key.startswith(own) for key in kept)
    assert (kept == left) == is_stored
    assert stack.http.get(f"{answer.json()['links']['video']}").content == ARTIFACT


def test_the_sweep_leaves_a_young_import_and_one_that_was_recorded(
    stack: Stack, exported: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    ages = [timedelta(hours=25)]
    objects = MemoryObjectStore(clock=lambda: datetime.now(UTC) - ages[-1])
    monkeypatch.setattr(stack.service, "objects", objects)
    found = bring(stack.http, exported).json()["id"]
    while feeds.compact(store=stack.store, objects=objects):
        pass
    recorded = stack.store.get(found)
    stack.store.delete(found, recorded.version)  # As a database that was restored to an older moment,
    stack.store.deletion_ended(found)  # which knows of no deletion.
    ages.append(timedelta(hours=23))
    young = keys.imported("019aa3c2f0b9-0000000000", "0" * 64, "checkpoint")
    objects.put(young, b"its import is still running")
    before = [info.key for info in objects.list("")]
    for _ in sweep(store=stack.store, objects=objects):
        pass
    assert [info.key for info in objects.list("")] == before
