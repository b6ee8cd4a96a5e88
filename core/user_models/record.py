"""A user's model, and what a worker found in it."""

from typing import Any

from core.documents import Stored
from core.environments.info import Device
from core.environments.terms.inventory import Inventory
from core.errors import BadModel, ModelInUse, ModelNotFound
from core.physics.availability import EngineName
from core.storage import keys
from core.uploads.record import Upload, UploadKind, UploadStore


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


class ModelRecord(Upload):
    """id: `sha256:` and the hash of the file's bytes."""

    description: Description | None = None

    @property
    def is_settled(self) -> bool:
        """Whether its validation is complete."""
        return self.status == "refused" or (self.description is not None and self.description.complete)


MODELS = UploadKind(
    name="model",
    record=ModelRecord,
    description=Description,
    folder=keys.models(),
    prefix=keys.model,
    source=keys.model_source,
    missing=ModelNotFound,
    unusable=BadModel,
    in_use=ModelInUse,
)
ModelStore = UploadStore[ModelRecord]
