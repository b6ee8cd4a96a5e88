"""`gaitway import-0.1`: users' models become part of the record."""

import pytest

from core.adapters.postgres.jobs import PostgresJobStore
from core.errors import ModelNotFound
from core.jobs.store import Dispatch
from tests.unit.gaitway.version_01.old import IDS, MODELS, Old, listed


class TestModels:
    def test_every_model_is_there_as_it_was(self, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        found = {record.id: record for record in job_store.models()}
        assert {name: found[model_id].status for name, model_id in MODELS.items()} == {
            "ready": "ready",
            "validating": "validating",
            "refused": "refused",
        }
        assert found[MODELS["refused"]].message == "It has no joints."
        description = found[MODELS["ready"]].description
        assert description is not None
        assert (description.complete, description.inventory.bodies) == (True, ["box"])
        assert description.engines == {"native": None, "mjx": "It has a tendon."}

    def test_one_that_waits_for_its_validation_is_dispatched(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        old.import_all()
        assert Dispatch("model", MODELS["validating"]) in job_store.undispatched()

    def test_what_was_found_out_since_stays(self, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        record = job_store.find_model(MODELS["validating"])
        job_store.settle_model(record.model_copy(update={"status": "refused", "message": "No."}))
        old.import_all()
        assert job_store.find_model(MODELS["validating"]).message == "No."

    def test_a_damaged_one_is_named_and_the_others_come(self, old: Old, job_store: PostgresJobStore) -> None:
        model_id = MODELS["ready"]
        old.objects.put(f"models/{model_id.removeprefix('sha256:')}/record.json", b'{"id": 1')
        is_whole, said = old.import_all()
        assert not is_whole
        assert any(model_id in line and "is skipped" in line for line in said)
        assert {record.id for record in job_store.models()} == set(MODELS.values()) - {model_id}
        with pytest.raises(ModelNotFound):
            job_store.find_model(model_id)
        assert set(listed(job_store)) == set(IDS)
