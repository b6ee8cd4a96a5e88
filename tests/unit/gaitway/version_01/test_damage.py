"""`gaitway import-0.1`: what is damaged is named, and the rest comes."""

import re
from collections.abc import Callable
from typing import Any

import pytest

from core.adapters.postgres.jobs import PostgresJobStore
from core.jobs.job import Job
from tests.unit.gaitway.version_01.old import (
    IDS,
    Old,
    listed,
)

DAMAGES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "no JSON": (lambda document: '{"id": "01', "Unterminated string"),
    "no object": (lambda document: "[]", "not a JSON object"),
    "no specification": (lambda document: {**document, "spec": None}, "its specification: Input should be"),
    "another job's": (lambda document: {**document, "id": IDS["queued"]}, f"belongs to job {IDS['queued']}"),
    "an unknown status": (lambda document: {**document, "status": "asleep"}, "status"),
    "a number of the wrong kind": (
        lambda document: {**document, "spec": {**document["spec"], "seed": "many"}},
        "seed",
    ),
    # Python has room for it, and PostgreSQL has not.
    "a version that is too large": (lambda document: {**document, "version": 2**40}, "out of range"),
}


class TestDamage:
    @pytest.mark.parametrize("damage", DAMAGES)
    def test_a_record_that_cannot_be_read_is_named_and_the_others_come(
        self, damage: str, old: Old, job_store: PostgresJobStore
    ) -> None:
        change, words = DAMAGES[damage]
        document = change(old.live("failed"))
        old.write_live("failed", document)
        old.write_copy("failed", document)
        is_whole, said = old.import_all()
        assert not is_whole
        (line,) = [line for line in said if IDS["failed"] in line]
        assert "is skipped" in line
        assert re.search(words, line)
        assert set(listed(job_store)) == set(IDS) - {"failed"}
        assert said[-1] == "Jobs: 7 imported, 0 in the record before, 1 not readable."

    def test_fields_that_nobody_knows_are_passed_over(self, old: Old, job_store: PostgresJobStore) -> None:
        document = old.live("running")
        before = Job.model_validate(document)
        document["colour"] = "green"
        document["attempts"][0]["mood"] = "good"
        document["artifacts"][0]["weight"] = 1
        document["spec"]["haste"] = {"much": True}
        document["spec"]["environment"]["haste"] = 1
        old.write_live("running", document)
        assert old.import_all()[0]
        job = job_store.get(IDS["running"])
        assert (job.spec, job.artifacts, job.attempts[0]) == (
            before.spec,
            before.artifacts,
            before.attempts[0],
        )

    def test_progress_that_was_not_finite_loses_that_number_alone(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        progress = '{"step":300,"total":1000,"steps_per_second":5.0,"eta_s":1.0,"metrics":{"a":null,"b":2.0}}'
        old.write_live("running", old.live("running"), progress=progress)
        old.import_all()
        found = job_store.get(IDS["running"]).progress
        assert (found.step, found.metrics) == (300, {"b": 2.0})

    def test_a_job_that_was_deleted_does_not_come_back(self, old: Old, job_store: PostgresJobStore) -> None:
        # A deletion removes the files first: cut short, it leaves the record in Redis.
        old.objects.delete_prefix(f"jobs/{IDS['failed']}/")
        is_whole, said = old.import_all()
        assert is_whole
        assert set(listed(job_store)) == set(IDS) - {"failed"}
        assert any("1 jobs that Redis has are left out" in line for line in said)
