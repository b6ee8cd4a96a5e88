"""The protocol between the process that trains a cohort and the process of each member.

They share a socket pair, on which a member asks and is answered. First it sends its task and gets Begun; then
it sends a Request, and gets a moment of its run or the bytes it asked for. A member that leaves closes it.
"""

import json
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

from core.algorithms.events import CheckpointReady, Evaluated, Evaluating, Event, Phase, Progress
from core.documents import Stored
from core.errors import JobFailed
from core.reasons import Reason

_EVENTS: dict[str, type[Event]] = {
    one.__name__: one for one in (Phase, Progress, Evaluating, Evaluated, CheckpointReady)
}


class Request(bytes, Enum):
    """What a member may ask for. NEXT: the next moment, once all members have asked for it."""

    NEXT = b"next"
    CHECKPOINT = b"checkpoint"
    POLICY = b"policy"


class Begun(Stored):
    """The facts of the device and the engine that train the cohort, and the steps at the end of the run."""

    device: str
    engine: str
    engine_reason: str
    total: int
    num_members: int


@dataclass(frozen=True)
class Moment:
    """What a member sees next, with its own step then; None at the end of its run."""

    step: int
    seen: Event | JobFailed | None


def pack(moment: Moment) -> bytes:
    """As JSON; a metric that is not finite stays so."""
    match moment.seen:
        case None:
            said: dict[str, Any] = {}
        case JobFailed() as failed:
            said = {"failed": failed.reason, "detail": failed.detail}
        case event:
            said = {"event": type(event).__name__, "fields": asdict(event)}
    return json.dumps({"step": moment.step, **said}, default=float).encode()


def unpack(content: bytes) -> Moment:
    """The moment that `pack` wrote."""
    said = json.loads(content)
    if "failed" in said:
        return Moment(said["step"], JobFailed(Reason(said["failed"]), said["detail"]))
    if "event" in said:
        return Moment(said["step"], _EVENTS[said["event"]](**said["fields"]))
    return Moment(said["step"], None)
