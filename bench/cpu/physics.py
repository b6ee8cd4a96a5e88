"""Physics steps per second on the CPU: the `native` engine against a bare loop, and against MJX-JAX."""

import os

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from bench.measure.machine import num_cores, this_machine
from bench.measure.result import Figure, Options, Result, at_least
from bench.measure.statistics import alternate, ratios, spread
from core.physics.choose import engine_builder
from core.physics.engine import Engine, PhysicsState, SolverSettings
from core.physics.model import brax_model, initial_qpos

_UNIT = "physics steps/s"
_SUBSTEPS = 5
_BOUND = ("time", "qpos", "qvel", "qacc_warmstart")  # The engine's state of the ant, which has no `act`.
_BRAX_SOLVER = SolverSettings(iterations=1, ls_iterations=4, implicit_damping=False)

# MJX-JAX is slow on a CPU, and XLA has been seen to stop for good in its program for 512 environments.
_MJX_STEPS, _MJX_ENVS = 20, 64

Controls = NDArray[np.float32]
Rates = dict[str, list[float]]


def measure(options: Options) -> Result:
    """Measure the ant under random controls; every engine gets the same controls and initial states."""
    machine = this_machine()
    rounds, num_envs, num_steps = (2, 64, 10) if options.quick else (9, 512, 60)
    model = brax_model("ant")
    controls, states = _controls(model, num_steps, num_envs), _walking(model, num_envs)
    native = _compiled(engine_builder("native")(model, _SUBSTEPS, ()), states, controls)
    against_bare = alternate(rounds, native=native, bare=_bare(model, states, controls))
    few = controls[:_MJX_STEPS, :_MJX_ENVS]
    fewer = jax.tree.map(lambda x: x[:_MJX_ENVS], states)
    peers = {"mjx": _compiled(_mjx(model, None), fewer, few)}
    if not options.quick:
        peers["mjx_fast"] = _compiled(_mjx(model, _BRAX_SOLVER), fewer, few)
    against_mjx = alternate(1 if options.quick else 2, native=native, **peers)
    return Result(
        name="physics",
        title="Physics on the CPU, ant",
        command="./run bench physics",
        quick=options.quick,
        machine=machine,
        figures=_figures(against_bare, against_mjx),
        rows=_rows(bare=against_bare, mjx=against_mjx),
        notes=[
            f"{num_envs} ants under random actions, from states with feet on the floor. A physics step is "
            f"a substep: {_SUBSTEPS} to each action. Compilation is not counted. "
            f"MJX-JAX steps {_MJX_ENVS} of them.",
            "`native` and MJX-JAX run as training runs them: a compiled `scan` over a `vmap` of the engine's "
            "step. The bare loop binds the same fields, writes the same controls and never copies a result.",
            "With equal solvers both solve the model as it stands: Newton, 4 iterations, implicit damping. "
            "Brax's fast settings, which the catalog's ant has on `mjx`, are 1 iteration, 4 line-search "
            "iterations and no implicit damping: less accurate, so that ratio compares unequal work.",
        ],
    )


def _figures(bare: Rates, mjx: Rates) -> list[Figure]:
    figures = [
        Figure.of("`native`", spread(bare["native"]), _UNIT),
        Figure.of("bare `mujoco.batch` loop", spread(bare["bare"]), _UNIT),
        Figure.of("`native` ÷ bare loop", ratios(bare["native"], bare["bare"]), "×", at_least(0.85)),
    ]
    for name, settings in (("mjx", "equal solvers"), ("mjx_fast", "Brax's fast settings")):
        if name in mjx:
            figures += [
                Figure.of(f"MJX-JAX, {settings}", spread(mjx[name]), _UNIT),
                Figure.of(
                    f"`native` ÷ MJX-JAX, {settings}", ratios(mjx["native"], mjx[name]), "×", at_least(200)
                ),
            ]
    return figures


def _rows(**comparisons: Rates) -> list[dict[str, str | int | float | bool | None]]:
    return [
        {"comparison": comparison, "measurement": name, "round": turn, "steps_per_second": value}
        for comparison, found in comparisons.items()
        for name, values in found.items()
        for turn, value in enumerate(values)
    ]


def _mjx(model: mujoco.MjModel, accelerated: SolverSettings | None) -> Engine:
    return engine_builder("mjx")(model, _SUBSTEPS, (), accelerated=accelerated)


def _controls(model: mujoco.MjModel, num_steps: int, num_envs: int) -> Controls:
    """Uniform in ±1, [num_steps, num_envs, nu]."""
    shape = (num_steps, num_envs, model.nu)
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def _timed(run: Callable[[], object], controls: Controls) -> Callable[[], float]:
    """A function that measures one call's physics steps per second, after a first call that compiles."""
    run()
    physics_steps = controls.shape[0] * controls.shape[1] * _SUBSTEPS

    def measured() -> float:
        began = time.perf_counter()
        run()
        return physics_steps / (time.perf_counter() - began)

    return measured


def _walking(model: mujoco.MjModel, num_envs: int) -> PhysicsState:
    """Ants two seconds after their start: feet on the floor, where the solver has work to do."""
    engine = engine_builder("native")(model, _SUBSTEPS, ())
    qpos = jnp.tile(jnp.asarray(initial_qpos(model), jnp.float32), (num_envs, 1))
    states = jax.vmap(engine.reset)(qpos, jnp.zeros((num_envs, model.nv)))
    return _rolling(engine)(states, jnp.asarray(_controls(model, 40, num_envs)))


def _rolling(engine: Engine) -> Callable[[PhysicsState, jax.Array], PhysicsState]:
    """The states after controls [num_steps, num_envs, nu], as one compiled program."""

    def step(states: PhysicsState, control: jax.Array) -> tuple[PhysicsState, None]:
        return jax.vmap(engine.step)(states, control), None

    return jax.jit(lambda states, controls: jax.lax.scan(step, states, controls)[0])


def _compiled(engine: Engine, states: PhysicsState, controls: Controls) -> Callable[[], float]:
    roll, inputs = _rolling(engine), jnp.asarray(controls)
    return _timed(lambda: jax.block_until_ready(roll(states, inputs)), controls)


def _bare(model: mujoco.MjModel, states: PhysicsState, controls: Controls) -> Callable[[], float]:
    batch = Batch(model, controls.shape[1], nthread=min(controls.shape[1], num_cores()))
    control = batch.bind("ctrl")
    fields = {name: (batch.bind(name), np.array(getattr(states, name), np.float64)) for name in _BOUND}

    def run() -> object:
        for field, start in fields.values():
            field[...] = start.reshape(field.shape)
        for given in controls:
            control[...] = given
            batch.step(nstep=_SUBSTEPS, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        return batch

    return _timed(run, controls)
