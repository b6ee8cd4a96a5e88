"""What the record promises of listings of models and workers that are read page by page."""

from collections.abc import Callable, Iterator
from datetime import timedelta
from functools import partial
from typing import Any

import pytest
from structlog.testing import capture_logs

from core.errors import ModelNotFound, Rejected
from core.jobs.store import JobStore
from tests.contract.recording import LEASE, MODEL, NOW, Database, model, worker

NONSENSE = ["nonsense", "", "a\0b", "9" * 300, f"-1-{MODEL}", f"{'9' * 18}-{MODEL}", "7-sha256:0"]


def pages(read: Callable[..., Any], limit: int) -> Iterator[Any]:
    """Every page, each by the cursor of the one before."""
    page = read(limit=limit)
    yield page
    while page.next_cursor is not None:
        yield (page := read(cursor=page.next_cursor, limit=limit))


class TestModels:
    def test_pages_are_newest_first_and_without_gap(self, jobs: JobStore) -> None:
        # Sent one second after the other, except for the last two, which their ids order.
        sent = [NOW + timedelta(seconds=second) for second in (0, 1, 2, 3, 3)]
        made = [
            model(MODEL.replace("0", digit), created_at=at) for digit, at in zip("24135", sent, strict=True)
        ]
        for record in made:
            jobs.models.add(record)
        found = [list(page.uploads) for page in pages(jobs.models.list, 2)]
        assert found == [[made[4], made[3]], [made[2], made[1]], [made[0]]]

    def test_models_of_one_name_are_listed_alone(self, jobs: JobStore) -> None:
        made = [model(MODEL.replace("0", digit), name=name) for digit, name in zip("123", "aba", strict=True)]
        for record in made:
            jobs.models.add(record)
        found = [list(page.uploads) for page in pages(partial(jobs.models.list, name="a"), 1)]
        assert found == [[made[2]], [made[0]]]

    def test_a_name_that_is_given_during_the_validation_stays(self, jobs: JobStore) -> None:
        record = model(name="one")
        jobs.models.add(record)
        jobs.models.rename(record.id, "two")
        jobs.models.settle(record.model_copy(update={"status": "refused"}))
        found = jobs.models.find(record.id)
        assert (found.name, found.status) == ("two", "refused")
        with pytest.raises(ModelNotFound):
            jobs.models.rename(MODEL.replace("0", "9"), "two")

    def test_a_full_last_page_has_no_next_one(self, jobs: JobStore) -> None:
        for digit in "12":
            jobs.models.add(model(MODEL.replace("0", digit)))
        assert len(list(pages(jobs.models.list, 2))) == 1
        assert len(list(pages(jobs.models.list, 1))) == 2

    def test_the_next_page_is_there_although_the_model_of_its_cursor_was_deleted(
        self, jobs: JobStore
    ) -> None:
        made = [model(MODEL.replace("0", digit)) for digit in "321"]
        for record in made:
            jobs.models.add(record)
        first = jobs.models.list(limit=1)
        jobs.models.delete(made[0].id)
        assert list(jobs.models.list(cursor=first.next_cursor, limit=5).uploads) == made[1:]

    @pytest.mark.parametrize("cursor", [*NONSENSE, MODEL, "a:cpu:1"])
    def test_another_cursor_is_refused(self, jobs: JobStore, cursor: str) -> None:
        with pytest.raises(Rejected, match="not one that this listing gave") as refused:
            jobs.models.list(cursor=cursor)
        assert [problem.pointer for problem in refused.value.problems] == ["/cursor"]


class TestWorkers:
    def test_pages_are_ordered_by_name_and_without_gap(self, jobs: JobStore, database: Database) -> None:
        for name in "dbeacf":
            jobs.announce(worker(name), ttl=LEASE)
        database.change("UPDATE workers SET gone_at = gone_at - %s WHERE name = 'f'", LEASE)
        found = [[one.name for one in page.workers] for page in pages(jobs.list_workers, 2)]
        assert found == [["a", "b"], ["c", "d"], ["e"]]

    def test_those_that_cannot_be_read_hide_no_other(self, jobs: JobStore, database: Database) -> None:
        for name in "abcd":
            jobs.announce(worker(name), ttl=LEASE)
        database.change("UPDATE workers SET document = '{}' WHERE name IN ('a', 'b', 'c')")
        with capture_logs() as said:
            found = [[one.name for one in page.workers] for page in pages(jobs.list_workers, 2)]
        assert found == [[], ["d"]]
        assert [entry["event"] for entry in said] == ["worker_unreadable"] * 3

    def test_the_next_page_is_there_although_the_worker_of_its_cursor_left(self, jobs: JobStore) -> None:
        for name in "abc":
            jobs.announce(worker(name), ttl=LEASE)
        first = jobs.list_workers(limit=1)
        jobs.withdraw("a")
        assert [one.name for one in jobs.list_workers(cursor=first.next_cursor).workers] == ["b", "c"]

    @pytest.mark.parametrize("cursor", ["", "a\0b", "a b", "ä", "9" * 201])
    def test_what_is_no_workers_name_is_refused(self, jobs: JobStore, cursor: str) -> None:
        with pytest.raises(Rejected, match="not one that this listing gave") as refused:
            jobs.list_workers(cursor=cursor)
        assert [problem.pointer for problem in refused.value.problems] == ["/cursor"]
