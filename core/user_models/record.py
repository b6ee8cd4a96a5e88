"""A user's model, what a worker found in it, and the interfaces of its records and of its queue."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal, Protocol

from core.accounts.principal import Ownership
from core.documents import Stored
from core.environments.info import Device
from core.environments.terms.inventory import Inventory
from core.physics.availability import EngineName

ModelStatus = Literal["validating", "ready", "refused"]


class Description(Stored):
    """The contents of a model, and how it moves without actions.

    main: the document that was read, of those in its file. engines: null for an engine that can run it,
    otherwise the reason why it cannot; engines that were not tried are left out. complete: whether no more
    engines will be tried. trials: how each engine moved the model beside C MuJoCo, or why it was not tried
    here. code_seconds: how long its code took to make there. auto: the engine that a job with the tuned
    settings gets, by device. physics_steps_per_second: of C MuJoCo on one core, without actions.
    settled_height: the root's, in metres, after up to 2 s of that. notes: for people. recipe: options of
    `mjcf` under which the model learns to walk by command, without its id; None where there are none, or it
    was described before there were recipes. recipe_notes: what was guessed in it, or why there is none.
    recipe_engines: as `engines`, of the model with the recipe's edits, as far as reading it tells.
    """

    inventory: Inventory
    trials: dict[EngineName, str] = {}
    code_seconds: dict[EngineName, float] = {}
    auto: dict[Device, EngineName] = {}
    main: str | None = None
    engines: dict[EngineName, str | None] = {}
    complete: bool = False
    physics_steps_per_second: float
    settled_height: float
    notes: list[str] = []
    recipe: dict[str, Any] | None = None
    recipe_notes: list[str] = []
    recipe_engines: dict[EngineName, str | None] = {}


class ModelRecord(Stored):
    """id: `sha256:` and the file's hash. message, refused_at: why and when it was refused. size: bytes.

    name: for people, as its sender gave it; several models may have the same.
    """

    id: str
    name: str | None = None
    status: ModelStatus
    media_type: str
    size: int
    created_at: datetime
    description: Description | None = None
    message: str | None = None
    refused_at: datetime | None = None

    @property
    def is_settled(self) -> bool:
        """Whether its validation is complete."""
        return self.status == "refused" or (self.description is not None and self.description.complete)


class ModelQueue(Protocol):
    """At-least-once; both methods raise RecordsUnavailable when the queue cannot be reached."""

    def enqueue_model(self, model_id: str) -> None:
        """Let any worker validate the model, after all jobs. Doing so twice changes nothing."""
        ...

    def contains_model(self, model_id: str) -> bool:
        """Whether it waits, or a worker is validating it."""
        ...


@dataclass(frozen=True)
class ModelPage:
    """Some models, newest first, and the cursor of the next page; None at the end."""

    models: Sequence[ModelRecord]
    next_cursor: str | None


class ModelStore(Protocol):
    """Part of the record. Every method raises RecordsUnavailable when the store cannot be reached."""

    def find_model(self, model_id: str) -> ModelRecord:
        """Raises ModelNotFound."""
        ...

    def add_model(self, record: ModelRecord) -> None:
        """Store the record, in place of an earlier one; one that waits for its validation gets a dispatch."""
        ...

    def model_dispatched(self, model_id: str) -> None:
        """Record that the queue has received the model."""
        ...

    def name_model(self, model_id: str, name: str) -> None:
        """Give it another name. Raises ModelNotFound."""
        ...

    def settle_model(self, record: ModelRecord) -> None:
        """Store the result of the validation; the name stays.

        Raises ModelNotFound where the model was deleted meanwhile.
        """
        ...

    def delete_model(self, model_id: str) -> None:
        """Forget the record; a missing one is no error."""
        ...

    def num_waiting_models(self) -> int:
        """How many wait for validation."""
        ...

    def models(self) -> Sequence[ModelRecord]:
        """All models, ordered by id."""
        ...

    def list_models(
        self,
        *,
        cursor: str | None = None,
        limit: int = 50,
        name: str | None = None,
        projects: Collection[str] | None = None,
        owner: str | None = None,
    ) -> ModelPage:
        """Some of them, the last sent first. cursor: the `next_cursor` of an earlier page, Rejected for any
        other. name, projects, owner: only those; None: of any.
        """
        ...

    def claim_model(self, model_id: str, ownership: Ownership) -> None:
        """Let the project have the model, too; its first sender there owns it there. Raises ModelNotFound."""
        ...

    def owners_of_models(self, model_ids: Collection[str]) -> Mapping[str, Sequence[Ownership]]:
        """The projects that have each of these, by name, and who owns it there; unknown ones are left out."""
        ...

    def release_model(self, model_id: str, projects: Collection[str]) -> bool:
        """Take the model from these projects; whether another one has it."""
        ...
