"""A user's own model, for a job that names it."""

from collections.abc import Mapping

from core.environments import catalog
from core.environments.mjcf.check import problems
from core.environments.mjcf.info import MjcfOptions
from core.errors import ModelNotFound, Problem, Rejected
from core.jobs.spec import EnvironmentSpec
from core.physics.availability import EngineName, beyond
from core.user_models import library
from core.user_models.record import Description
from core.user_models.store import ModelStore

_POINTER = "/environment/options/model"


def own_model(options: MjcfOptions, store: ModelStore) -> Description:
    """The description of the model that the options name.

    Raises Rejected where the model does not exist, is not validated yet, or does not fit the options.
    """
    try:
        record = library.find(options.model, store)
    except ModelNotFound as error:
        raise Rejected(error.detail, [Problem(_POINTER, error.detail)]) from None
    if record.status != "ready" or record.description is None:
        detail = (
            f"The model {options.model} was refused: {record.message}"
            if record.status == "refused"
            else f"The model {options.model} is still being validated; ask GET /models/{options.model}."
        )
        raise Rejected(detail, [Problem(_POINTER, detail)])
    if found := problems(options, record.description.inventory):
        raise Rejected(" ".join(problem.detail for problem in found[:5]), found)
    return record.description


def model_of(environment: EnvironmentSpec) -> str | None:
    """The id of the user's own model that an environment names; the environment was checked before."""
    if not catalog.find(environment.id).takes_model:
        return None
    return str(environment.options["model"])


def engines_that_cannot(description: Description | None, options: MjcfOptions) -> Mapping[EngineName, str]:
    """Engines that cannot run the model, or read what the options read of it, each with the reason."""
    if description is None:
        return {}
    tried = description.engines.items()
    cannot: dict[EngineName, str] = {name: why for name, why in tried if why is not None}
    for sensor in description.inventory.sensors:
        if options.sensors is None or sensor.name in options.sensors:
            for engine, why in sensor.beyond.items():
                cannot.setdefault(engine, beyond(engine, why))
    return cannot
