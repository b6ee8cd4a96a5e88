"""From a specification to a running sweep."""

from core.errors import TooManySweeps
from core.jobs.job import new_job_id
from core.jobs.store import Idempotency
from core.sweeps.checks import checked
from core.sweeps.spec import SweepSpec
from core.sweeps.store import SweepStore
from core.sweeps.sweep import Sweep

# The reconciler looks at each of them every second.
MOST_ACTIVE = 100


def submit_sweep(spec: SweepSpec, *, store: SweepStore, idempotency: Idempotency | None = None) -> Sweep:
    """Store the sweep; the reconciler starts its trials. Or return the one that the same key created.

    Raises Rejected, TooManySweeps, IdempotencyKeyReused, RecordsUnavailable.
    """
    spec = checked(spec, store)
    now = store.now()
    sweep = Sweep(id=new_job_id(now), spec=spec, created_at=now)
    return store.add_sweep(sweep, idempotency, most_active=MOST_ACTIVE)


def check_room(store: SweepStore) -> None:
    """Before one more sweep runs. Raises TooManySweeps."""
    if store.num_active_sweeps() >= MOST_ACTIVE:
        raise TooManySweeps(MOST_ACTIVE)
