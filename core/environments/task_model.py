"""From a specification to the model that a task steps, with sensors for what its terms read of contacts."""

from collections.abc import Iterable

import mujoco

from core.environments.terms.added_sensors import add_sensors
from core.environments.terms.inventory import Inventory
from core.environments.terms.readings import Reading
from core.environments.terms.task import TaskOptions
from core.environments.terrain.model import add_boxes
from core.errors import JobFailed
from core.physics.engine import SolverSettings
from core.reasons import Reason


def compiled(
    spec: mujoco.MjSpec,
    timestep: float | None = None,
    readings: Iterable[Reading] = (),
    sensors: list[str] | None = None,
) -> mujoco.MjModel:
    """The model, with sensors for these readings, and without sleep: no engine carries who sleeps.

    sensors: those of its own to keep, so that an engine need not have the others; None: all.
    Raises JobFailed("bad_model").
    """
    spec.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    if timestep is not None:
        spec.option.timestep = timestep
    for sensor in spec.sensors if sensors is not None else ():
        if sensor.name not in sensors:
            spec.delete(sensor)
    add_sensors(spec, readings)
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise JobFailed(Reason.BAD_MODEL, sentence(error, spec.modelfiledir)) from None


def stepped_model(spec: mujoco.MjSpec, options: TaskOptions, parts: Inventory) -> mujoco.MjModel:
    """The model on its terrain, under the task's timestep. parts: of the model without either.

    Raises JobFailed("bad_model").
    """
    if options.terrain is not None:
        add_boxes(spec, compiled(spec), options.terrain)
    return compiled(spec, options.timestep, options.readings(parts), options.sensors)


def solver_settings(options: TaskOptions) -> SolverSettings:
    """How far engines solve under these options."""
    return SolverSettings(
        options.iterations,
        options.ls_iterations,
        implicit_damping=True,
        solver=options.solver,
        nconmax=options.nconmax,
    )


def sentence(error: Exception, folder: str) -> str:
    """MuJoCo's message in one line, without our folder's path."""
    words = " ".join(str(error).replace(folder, "").split())
    return f"MuJoCo cannot compile the model: {words[:500]}"
