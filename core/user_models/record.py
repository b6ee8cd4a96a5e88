"""A model that somebody sent, and what a worker found in it."""

from datetime import datetime
from typing import Literal

from core.documents import Stored
from core.environments.mjcf.inventory import Inventory
from core.physics.availability import EngineName

ModelStatus = Literal["validating", "ready", "refused"]


class Description(Stored):
    """What is in a model, and what it does when it is let go.

    engines: null for one that can run it, otherwise what keeps it from that; one that was not tried is not
    in it. complete: whether none will be any more. physics_steps_per_second: C MuJoCo's, on one core, while
    nothing acts. settled_height: the root's in metres after up to 2 s of that. notes: for people.
    """

    inventory: Inventory
    engines: dict[EngineName, str | None] = {}
    complete: bool = False
    physics_steps_per_second: float
    settled_height: float
    notes: list[str] = []


class ModelRecord(Stored):
    """id: `sha256:` and the hash of the file. message, refused_at: why and when it was. size: bytes."""

    id: str
    status: ModelStatus
    media_type: str
    size: int
    created_at: datetime
    description: Description | None = None
    message: str | None = None
    refused_at: datetime | None = None

    @property
    def is_settled(self) -> bool:
        """Whether nothing more will be found out."""
        return self.status == "refused" or (self.description is not None and self.description.complete)
