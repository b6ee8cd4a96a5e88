"""From a specification to a running sweep."""

from core.jobs.job import new_job_id
from core.jobs.store import Idempotency
from core.sweeps.checks import checked
from core.sweeps.spec import SweepSpec
from core.sweeps.store import SweepStore
from core.sweeps.sweep import Sweep


def submit_sweep(spec: SweepSpec, *, store: SweepStore, idempotency: Idempotency | None = None) -> Sweep:
    """Store the sweep; the reconciler starts its trials. Or return the one that the same key created.

    Raises Rejected, IdempotencyKeyReused, RecordsUnavailable.
    """
    spec = checked(spec, store)
    now = store.now()
    return store.add_sweep(Sweep(id=new_job_id(now), spec=spec, created_at=now), idempotency)
