"""The messages between the workers of a gang: the leader, of rank 0, has the job; the others are members."""

from importlib.metadata import version
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from core.documents import Stored
from core.environments.catalog import PLUGINS
from worker.protocol import Failed, Task

_PACKAGES = ("gaitway", "jax", "jaxlib", "brax", "mujoco", "mujoco-mjx")


class Joined(Stored):
    """A member's first message. num_gpus: 0 for the CPU. versions: of the packages that must be the same."""

    type: Literal["joined"] = "joined"
    rank: int
    host: str
    num_gpus: int
    versions: dict[str, str]


class Refused(Stored):
    """The leader's answer to a member that does not fit; the connection then ends."""

    type: Literal["refused"] = "refused"
    why: str


class Begin(Stored):
    """Start the part of an attempt: its task, and the sizes in bytes of the spool's files, which follow as
    frames of their content, in this order."""

    type: Literal["begin"] = "begin"
    task: Task
    files: dict[str, int]


class Over(Stored):
    """The attempt has ended: end its process."""

    type: Literal["over"] = "over"


class Alive(Stored):
    """A sign of life, from both sides, while an attempt runs."""

    type: Literal["alive"] = "alive"


class Printed(Stored):
    """A line that a member's process printed."""

    type: Literal["printed"] = "printed"
    text: str


class Leaving(Stored):
    """The member's worker must shut down: the job is to keep a checkpoint and go back to the queue."""

    type: Literal["leaving"] = "leaving"


class Ended(Stored):
    """A member's process has ended, and nothing of it is left.

    status: negative: the signal that ended it. failure: what it said last. is_stopped: whether its worker
    ended it because the attempt was over.
    """

    type: Literal["ended"] = "ended"
    status: int
    failure: Failed | None = None
    is_stopped: bool = False


GangMessage = Annotated[
    Joined | Refused | Begin | Over | Alive | Printed | Leaving | Ended, Field(discriminator="type")
]
GANG_MESSAGE: TypeAdapter[GangMessage] = TypeAdapter(GangMessage)


def encoded(message: GangMessage) -> bytes:
    return message.model_dump_json().encode()


def versions_here() -> dict[str, str]:
    plugins = {plugin.package: plugin.exact_version for plugin in PLUGINS if not plugin.problem}
    return {**plugins, **{name: version(name) for name in _PACKAGES}}
