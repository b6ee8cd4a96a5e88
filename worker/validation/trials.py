"""Each engine loads a model and moves it beside C MuJoCo."""

import time
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, get_args

import mujoco

from core.environments.info import Device
from core.environments.mjcf.info import INFO, MjcfOptions
from core.errors import JobFailed
from core.physics.availability import EngineName, beyond, choose_by_rules, is_installed
from core.user_models.record import Description
from mujoco_compiled import meshes_left_out

_LONGEST_REASON = 300
# C MuJoCo itself takes three seconds of the model's time; a scene that is slower than that is not tried.
_LONGEST_REFERENCE_S, _REFERENCE_S = 15.0, 3.0
# As many environments as the tuned settings take, or more.
_MANY = 1024
_QUICK: tuple[EngineName, ...] = ("native", "compiled")
_NOT_HERE = "not tried here: it needs a GPU"


def tried(description: Description, model: mujoco.MjModel, whole: mujoco.MjModel) -> Iterator[Description]:
    """The description after each engine's trial. model: with the sensors that all engines read; whole: with
    all sensors.

    Engines that are refused already are left out, and `warp` is loaded alone: its kernels need a GPU.
    """
    motion = _Motion(model, description.physics_steps_per_second)
    passing = meshes_left_out(model)
    without = _Motion(model, description.physics_steps_per_second, passing) if passing else motion
    for name in _QUICK:
        # What `compiled` leaves out has been said: its trial is of all else.
        description = _after(description, name, model, without if name == "compiled" else motion)
        yield description
    loads: Mapping[EngineName, Callable[[mujoco.MjModel], None]] = {"mjx": _load_mjx, "warp": _load_warp}
    for name, load in loads.items():
        if name not in description.engines and is_installed(name):
            description = _with(description, name, what_keeps(load, whole))
            yield description
    if description.engines.get("warp") is None:
        description = _with_trial(description, "warp", _NOT_HERE)
    yield _after(description, "mjx", model, motion).model_copy(update={"complete": True})  # It takes longest.


def with_choices(description: Description) -> Description:
    """With the engine that `auto` takes on each device for many environments."""
    cannot: dict[EngineName, str] = {
        name: why for name, why in description.engines.items() if why is not None
    }
    body = description.inventory.body_size
    taken = {
        device: choose_by_rules(device, _MANY, INFO.rules_on(device), cannot, body).name
        for device in get_args(Device)
    }
    return description.model_copy(update={"auto": taken})


def what_keeps(attempt: Callable[[mujoco.MjModel], None], model: mujoco.MjModel) -> str | None:
    """The sentence of the attempt's error; None if it succeeds."""
    try:
        attempt(model)
    except Exception as error:  # Whatever it is, it is the answer.
        return _sentence(error)
    return None


def _sentence(error: Exception) -> str:
    words = " ".join(str(error).split()) or type(error).__name__
    return f"{words[:_LONGEST_REASON].removesuffix('.')}."


class _Motion:
    """C MuJoCo's motion, recorded when it is first asked for: JAX takes seconds to load. apart: numbers of
    geoms that pass through each other."""

    def __init__(
        self, model: mujoco.MjModel, steps_per_second: float, apart: Collection[tuple[int, int]] = ()
    ) -> None:
        self._model, self._apart = model, apart
        seconds = _REFERENCE_S / model.opt.timestep / steps_per_second
        self.why_not = (
            f"not tried here: C MuJoCo alone would take {seconds:.0f} s"
            if seconds > _LONGEST_REFERENCE_S
            else ""
        )
        self._recorded: Any = None

    def reference(self) -> Any:
        """None, with `why_not`, if there is none."""
        from core.physics.trial import record

        if self._recorded is None and not self.why_not:
            self._recorded = record(self._model, apart=self._apart)
            if self._recorded is None:
                self.why_not = "not tried here: C MuJoCo itself becomes unstable, without any action"
        return self._recorded


def _after(description: Description, name: EngineName, model: mujoco.MjModel, motion: _Motion) -> Description:
    """The description after this engine's trial."""
    if description.engines.get(name) is not None:
        return description
    if not is_installed(name):
        return _with_trial(description, name, "not tried here: it is not installed")
    reference = motion.reference()
    if reference is None:
        return _with(description, name, None, motion.why_not)
    return _compared(description, name, model, reference)


def _compared(
    description: Description, name: EngineName, model: mujoco.MjModel, reference: Any
) -> Description:
    """After the engine has moved the model as a job does that leaves the solver's settings out."""
    from core.physics.choose import engine_builder
    from core.physics.engine import SolverSettings
    from core.physics.trial import compare

    fields = MjcfOptions.model_fields
    settings = SolverSettings(
        fields["iterations"].default, fields["ls_iterations"].default, implicit_damping=True
    )
    derived = ("sensordata",) if model.nsensor else ()
    began = time.perf_counter()
    try:
        engine = engine_builder(name)(model, reference.num_substeps, derived, accelerated=settings)
        difference = compare(engine, reference)
    except JobFailed as failed:
        return _with(description, name, failed.detail)
    except Exception as error:  # This process has less memory and time than a job: it says nothing about one.
        return _with_trial(description, name, f"not tried here: {_sentence(error)}")
    words = difference.words(reference.num_tries)
    if reference.share < 1.0:
        words += f", under {reference.share:g} of its actions: under more, C MuJoCo itself becomes unstable"
    if not difference.is_right:
        return _with(description, name, beyond(name, words))
    seconds = {**description.code_seconds, name: round(time.perf_counter() - began, 1)}
    return _with(description, name, None, words).model_copy(update={"code_seconds": seconds})


def _with(
    description: Description, name: EngineName, why: str | None, words: str | None = None
) -> Description:
    """With the engine's verdict, and how it did."""
    found = description.model_copy(update={"engines": {**description.engines, name: why}})
    return found if why is not None or words is None else _with_trial(found, name, words)


def _with_trial(description: Description, name: EngineName, words: str) -> Description:
    return description.model_copy(update={"trials": {**description.trials, name: words}})


def _load_mjx(model: mujoco.MjModel) -> None:
    """Load it and trace a step, which alone shows some of what MJX lacks. Nothing is compiled."""
    import jax
    from mujoco import mjx

    on_device = mjx.put_model(model)
    jax.eval_shape(lambda: mjx.step(on_device, mjx.make_data(model)))


def _load_warp(model: mujoco.MjModel) -> None:
    import warp
    from mujoco.mjx.third_party import mujoco_warp

    warp.config.log_level = warp.LOG_ERROR
    with warp.ScopedDevice("cpu"):
        put: Any = mujoco_warp.put_model
        put(model)
