"""The task of a training process whose job names a user's own model."""

import hashlib
from pathlib import Path

from core.adapters.postgres.store import PostgresJobStore
from core.jobs.attempts import Claim
from core.physics.availability import BodySize
from core.storage import keys
from tests.contract.recording import held, model, queued_job
from tests.contract.test_job_store import DESCRIPTION
from tests.in_memory import MemoryObjectStore
from worker.protocol import Task
from worker.supervision.starting_point import write_task

SENT = b"<mujoco/>"
MODEL = f"sha256:{hashlib.sha256(SENT).hexdigest()}"


def test_its_size_and_the_engines_that_cannot_run_it(job_store: PostgresJobStore, tmp_path: Path) -> None:
    objects = MemoryObjectStore()
    objects.put(keys.model_source(MODEL), SENT)
    sizes = DESCRIPTION.inventory.sizes.model_copy(update={"nv": 14})
    inventory = DESCRIPTION.inventory.model_copy(update={"sizes": sizes, "num_pairs": 4})
    job_store.models.add(model(MODEL, description=DESCRIPTION.model_copy(update={"inventory": inventory})))
    environment = {"id": "mjcf", "options": {"model": MODEL, "reward": [{"kind": "alive"}]}}
    job = held(job_store, queued_job(environment=environment))
    assert write_task(job, Claim(job.id, 1, job.token, job_store, objects), "cpu", tmp_path) == []
    task = Task.model_validate_json((tmp_path / "task.json").read_bytes())
    assert (task.model, task.body, task.engines_that_cannot) == ("model", BodySize(14, 4), {"mjx": "No."})
    assert (tmp_path / "model").read_bytes() == SENT
