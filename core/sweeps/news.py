"""What a sweep's end is news of."""

from core.news.webhook import News, SweepEvent, new_message
from core.sweeps.sweep import Sweep, SweepStatus

_ENDS: dict[SweepStatus, SweepEvent] = {
    SweepStatus.SUCCEEDED: "sweep.succeeded",
    SweepStatus.FAILED: "sweep.failed",
    SweepStatus.CANCELLED: "sweep.cancelled",
}


def news_of_sweep(sweep: Sweep) -> News | None:
    """The message about a sweep that has just come to its status; None where it goes on."""
    event = _ENDS.get(sweep.status)
    if event is None:
        return None
    data = {
        "id": sweep.id,
        "name": sweep.spec.name,
        "environment": sweep.spec.job.environment.id,
        "project": sweep.project,
        "owner": sweep.owner,
        "status": sweep.status,
        "message": sweep.message,
        "created_at": sweep.created_at,
        "finished_at": sweep.finished_at,
        "href": f"/sweeps/{sweep.id}",
    }
    return new_message(
        event,
        sweep.finished_at or sweep.created_at,
        data,
        project=sweep.project,
        owner=sweep.owner,
        notify=tuple(sweep.spec.job.notify),
    )
