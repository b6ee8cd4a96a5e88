"""Submits, changes, cancels, resumes and deletes a sweep for its user."""

from collections.abc import Collection
from contextlib import suppress

import structlog
from pydantic import ValidationError

from core.accounts.principal import NOBODYS, Ownership
from core.errors import (
    JobNotFound,
    Problem,
    Rejected,
    StaleSweep,
    SweepFinished,
    SweepNotFinished,
    TooManySweeps,
)
from core.jobs.decoders import check_readable_decoder
from core.jobs.experts import check_readable_experts
from core.jobs.job import new_job_id
from core.jobs.patch import JobPatch, merged
from core.jobs.queue import PRIORITIES
from core.jobs.quotas import check_quotas
from core.jobs.source import source_artifact
from core.jobs.spec import JobSpec
from core.jobs.store import Idempotency
from core.jobs.submission import check_notify, check_readable_source, check_readable_uploads
from core.sweeps.axes import axis_place, ends, job_of
from core.sweeps.checks import check_budget, check_labels, checked, in_the_job
from core.sweeps.spec import Budget, Range, SweepSpec
from core.sweeps.sweep import Sweep, SweepStatus, SweepStore

log = structlog.get_logger()

# The reconciler looks at each of them every second.
MOST_ACTIVE = 100
# The fields of a job that may name another one, or a model.
_NAMING_OTHERS = ("resume_from", "policy", "environment", "algorithm")


def submit_sweep(
    spec: SweepSpec,
    *,
    store: SweepStore,
    ownership: Ownership = NOBODYS,
    idempotency: Idempotency | None = None,
) -> Sweep:
    """Store the sweep; the reconciler starts its trials. Or return the one that the same key created.

    An owner's sweep uses checkpoints, models and clips of its own project alone, because its trials start
    when nobody is there to ask. Raises Rejected, QuotaExceeded, TooManySweeps,
    IdempotencyKeyReused, RecordsUnavailable.
    """
    _check_readable(spec, readable_by(ownership), store)
    try:
        check_notify(spec.job, ownership.project, store)
    except Rejected as error:
        raise in_the_job(error) from None
    spec = checked(spec, store)
    if idempotency is not None and (known := store.remembered_sweep(idempotency)) is not None:
        return known
    check_quotas(_most_urgent(spec), ownership, store, with_queue=True)
    now = store.now()
    sweep = Sweep(
        id=new_job_id(now), spec=spec, created_at=now, owner=ownership.owner, project=ownership.project
    )
    try:
        stored = store.add_sweep(sweep, idempotency, most_active=MOST_ACTIVE)
    except JobNotFound as error:  # The checkpoint was removed between the check and this.
        raise _gone(error, spec, store) from None
    log.info("sweep_submitted", sweep_id=stored.id)
    return stored


def _most_urgent(spec: SweepSpec) -> JobSpec:
    """The job, with the highest priority that a trial may have."""
    axis = spec.parameters.get("priority", [spec.job.priority])
    highest = next((priority for priority in PRIORITIES if priority in ends(axis)), spec.job.priority)
    return spec.job.model_copy(update={"priority": highest})


def _check_readable(spec: SweepSpec, readable: Collection[str] | None, store: SweepStore) -> None:
    """Refuse checkpoints, models and clips of other projects, in the job and in the values of its axes."""
    if readable is None:
        return
    try:
        _check_readable_job(spec.job, readable, store)
    except Rejected as error:
        raise in_the_job(error) from None
    for name, axis in spec.parameters.items():
        if isinstance(axis, Range) or name.partition(".")[0] not in _NAMING_OTHERS:
            continue
        for value in axis:
            with suppress(ValidationError):  # The check of all values says what is wrong.
                job = job_of(spec.job, {name: value})
                try:
                    _check_readable_job(job, readable, store)
                except Rejected as error:
                    raise Rejected(error.detail, [Problem(axis_place(name), error.detail)]) from None


def _check_readable_job(job: JobSpec, readable: Collection[str], store: SweepStore) -> None:
    check_readable_source(job, readable, store)
    check_readable_decoder(job.environment, readable, store)
    check_readable_experts(job, readable, store)
    check_readable_uploads(job.environment, readable, store)


def readable_by(ownership: Ownership) -> frozenset[str] | None:
    """The projects whose checkpoints, models and clips the trials may use; None: all."""
    return None if ownership.owner is None else frozenset({ownership.project})


def check_room(store: SweepStore) -> None:
    """Before one more sweep runs. Raises TooManySweeps."""
    if store.num_active_sweeps() >= MOST_ACTIVE:
        raise TooManySweeps(MOST_ACTIVE)


def patch_sweep(sweep_id: str, patch: JobPatch, *, store: SweepStore) -> Sweep:
    """Change its name, labels and note; trials that begin after that get the labels.

    Raises SweepNotFound; Rejected where it would have too many labels.
    """
    while True:
        sweep = store.get_sweep(sweep_id)
        said = merged(sweep.spec.model_dump(include={"name", "labels", "note"}), patch)
        changes = {name: said.get(name, {} if name == "labels" else None) for name in patch.model_fields_set}
        spec = sweep.spec.model_copy(update=changes)
        check_labels(spec)
        if spec == sweep.spec:
            return sweep
        try:
            store.save_sweep(changed := sweep.next(spec=spec))
        except StaleSweep:
            continue
        return changed


def cancel_sweep(sweep_id: str, *, store: SweepStore) -> Sweep:
    """Start no more trials; the reconciler cancels those that run, which keep their work.

    Cancelling twice changes nothing. Raises SweepNotFound; SweepFinished if it has succeeded or failed.
    """
    while True:
        sweep = store.get_sweep(sweep_id)
        if sweep.status in (SweepStatus.CANCELLING, SweepStatus.CANCELLED):
            return sweep
        if sweep.status.is_final:
            raise SweepFinished(f"Sweep {sweep_id} has already {sweep.status}; there is nothing to cancel.")
        try:
            store.save_sweep(cancelling := sweep.next(status=SweepStatus.CANCELLING))
        except StaleSweep:
            continue
        return cancelling


def resume_sweep(sweep_id: str, budget: Budget, *, store: SweepStore) -> Sweep:
    """Let an ended sweep, or one that runs, continue under another budget, which replaces the one before.

    Its trials stay: the next one has the number after the last. Raises SweepNotFound, Rejected,
    TooManySweeps; StaleSweep while it is being cancelled.
    """
    while True:
        sweep = store.get_sweep(sweep_id)
        if sweep.status == SweepStatus.CANCELLING:
            raise SweepNotFinished(f"Sweep {sweep_id} is still being cancelled; resume it afterwards.")
        spec = sweep.spec.model_copy(update={"budget": budget})
        if not spec.has_own_end and not budget.has_limit:
            detail = f"The method `{spec.method}` has no end of its own: give `jobs`, `steps` or `gpu_hours`."
            raise Rejected(detail, [Problem("/budget", detail)])
        if sweep.status.is_final:
            check_room(store)
        check_budget(spec, store.trials([sweep_id]).get(sweep_id, ()), store)
        changes = {"spec": spec, "status": SweepStatus.RUNNING, "message": None, "finished_at": None}
        try:
            store.save_sweep(resumed := sweep.next(**changes))
        except StaleSweep:
            continue
        except JobNotFound as error:
            raise _gone(error, spec, store) from None
        return resumed


def _gone(error: JobNotFound, spec: SweepSpec, store: SweepStore) -> Rejected:
    """Why the checkpoint that the sweep's job needs is not there."""
    job = spec.job
    try:
        if job.source is not None:
            source_artifact(job, job.source, store.get)
    except Rejected as refusal:
        return in_the_job(refusal)
    return Rejected(error.detail, [Problem("/job", error.detail)])


def delete_sweep(sweep_id: str, *, store: SweepStore) -> None:
    """Delete the record of an ended sweep; its jobs stay. Raises SweepNotFound, SweepNotFinished."""
    sweep = store.get_sweep(sweep_id)
    if not sweep.status.is_final:
        raise SweepNotFinished(f"Sweep {sweep_id} is {sweep.status}; cancel it first.", sweep=sweep_id)
    store.delete_sweep(sweep_id, sweep.version)
