"""One set of tests for all engines: what an environment may rely on, whichever engine moves it."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from flax import serialization

from core.environments import catalog
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from core.physics.engine import DERIVED_FIELDS, Engine, PhysicsState, SolverSettings
from core.physics.model import brax_model, initial_qpos, of_parts
from tests.extra import extra

NUM_SUBSTEPS = 3
# A ball with an arm that falls on a floor: contacts, a tendon, sites, sensors, and an actuator with a state.
BODY = """
<mujoco>
  <option timestep="0.005" iterations="30" ls_iterations="30"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body name="ball" pos="0 0 0.105">
      <freejoint/>
      <geom type="sphere" size="0.1"/>
      <body name="arm" pos="0.1 0 0">
        <joint name="hinge" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03" contype="0" conaffinity="0"/>
        <site name="tip" pos="0.2 0 0"/>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="cord"><joint joint="hinge" coef="2"/></fixed></tendon>
  <actuator><general joint="hinge" dyntype="filter" dynprm="0.05" gainprm="2"/></actuator>
  <sensor>
    <jointpos joint="hinge"/><jointvel joint="hinge"/><framelinvel objtype="site" objname="tip"/>
  </sensor>
</mujoco>
"""
INTEGRATED = ("time", "qpos", "qvel", "act", "qacc_warmstart")
FRESH = tuple(name for name in DERIVED_FIELDS if name != "qfrc_actuator")


@dataclass(frozen=True)
class JittedEngine:
    """An engine for the body above; its functions compiled once, for one environment and for three."""

    model: mujoco.MjModel
    engine: Engine
    reset: Callable[..., PhysicsState]
    step: Callable[..., PhysicsState]
    reset_many: Callable[..., PhysicsState]
    step_many: Callable[..., PhysicsState]
    tolerance: float


@pytest.fixture(scope="module", params=["native", "compiled", *extra("mjx", "warp")])
def bench(request: pytest.FixtureRequest) -> JittedEngine:
    name: EngineName = request.param
    if name == "warp":
        request.getfixturevalue("warp_kernels")
    model = mujoco.MjModel.from_xml_string(BODY)
    engine = engine_builder(name)(model, NUM_SUBSTEPS, DERIVED_FIELDS)
    reset, step = jax.jit(engine.reset), jax.jit(engine.step)
    return JittedEngine(
        model,
        engine,
        reset,
        step,
        # JAX does not trace a jitted function again; MJX takes seconds to trace.
        jax.jit(jax.vmap(reset)),
        jax.jit(jax.vmap(step)),
        # Native computes in float64 and rounds; the others compute in float32.
        tolerance=1e-5 if name == "native" else 2e-3,
    )


def start(model: mujoco.MjModel, num_envs: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Different positions, velocities and controls for each environment."""
    key = jax.random.key(7)
    spread = jnp.linspace(0.0, 1.0, num_envs)[:, None]
    qpos = jnp.asarray(model.qpos0, jnp.float32) + spread * 0.3 * jnp.eye(model.nq)[-1]
    qvel = 0.2 * jax.random.normal(key, (num_envs, model.nv))
    return qpos, qvel, 0.5 + spread


def reference(model: mujoco.MjModel, qpos: Any, qvel: Any, ctrl: Any, num_steps: int) -> mujoco.MjData:
    """The same by plain MuJoCo, as after the last substep: derived fields are one substep old."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
    for _ in range(num_steps * NUM_SUBSTEPS):
        mujoco.mj_step(model, data)
    return data


def state_of(state: PhysicsState, index: int) -> PhysicsState:
    return jax.tree.map(lambda leaf: leaf[index], state)


def test_a_state_has_mujocos_shapes_in_float32(bench: JittedEngine) -> None:
    qpos, qvel, ctrl = start(bench.model, 3)
    data = mujoco.MjData(bench.model)
    for state in (bench.reset(qpos[0], qvel[0]), bench.step(bench.reset(qpos[0], qvel[0]), ctrl[0])):
        for name in INTEGRATED:
            assert getattr(state, name).shape == np.shape(getattr(data, name)), name
        for name in DERIVED_FIELDS:
            assert state.derived[name].shape == np.shape(getattr(data, name)), name
        assert {leaf.dtype for leaf in jax.tree.leaves(state)} == {np.dtype(np.float32)}


def test_a_reset_begins_at_rest_where_it_was_told(bench: JittedEngine) -> None:
    qpos, qvel, _ = start(bench.model, 3)
    state = bench.reset_many(qpos, qvel)
    np.testing.assert_array_equal(state.qpos, qpos)
    np.testing.assert_array_equal(state.qvel, qvel)
    assert not np.any(state.time)
    assert not np.any(state.act)
    assert not np.any(state.qacc_warmstart)


def test_steps_follow_plain_mujoco(bench: JittedEngine) -> None:
    # 20 steps: the ball falls on the floor and the arm swings, so contacts and joints both act.
    qpos, qvel, ctrl = start(bench.model, 3)
    state = bench.reset(qpos[1], qvel[1])
    for _ in range(20):
        state = bench.step(state, ctrl[1])
    data = reference(bench.model, qpos[1], qvel[1], ctrl[1], 20)
    assert data.ncon == 1
    for name in ("time", "qpos", "qvel", "act"):
        np.testing.assert_allclose(
            getattr(state, name), getattr(data, name), atol=bench.tolerance, err_msg=name
        )


def test_the_solvers_guess_is_carried_from_step_to_step(bench: JittedEngine) -> None:
    qpos, qvel, ctrl = start(bench.model, 3)
    state = bench.step(bench.step(bench.reset(qpos[0], qvel[0]), ctrl[0]), ctrl[0])
    data = reference(bench.model, qpos[0], qvel[0], ctrl[0], 2)
    assert np.abs(data.qacc_warmstart).max() > 1
    np.testing.assert_allclose(state.qacc_warmstart, data.qacc_warmstart, rtol=bench.tolerance, atol=0.05)


def test_derived_fields_describe_the_state_that_is_returned(bench: JittedEngine) -> None:
    qpos, qvel, ctrl = start(bench.model, 3)
    resting = bench.reset(qpos[2], qvel[2])
    for state in (resting, bench.step(resting, ctrl[2])):
        data = mujoco.MjData(bench.model)
        data.qpos[:], data.qvel[:] = state.qpos, state.qvel
        mujoco.mj_forward(bench.model, data)
        for name in FRESH:
            np.testing.assert_allclose(state.derived[name], getattr(data, name), atol=2e-6, err_msg=name)


def test_the_actuators_force_is_the_last_substeps(bench: JittedEngine) -> None:
    qpos, qvel, ctrl = start(bench.model, 3)
    state = bench.step(bench.reset(qpos[2], qvel[2]), ctrl[2])
    data = reference(bench.model, qpos[2], qvel[2], ctrl[2], 1)
    # A filter of 0.05 s seen 2 of 3 substeps in: act = 1.5 (1 - 0.9²) = 0.285, times the gain of 2.
    assert data.qfrc_actuator[-1] == pytest.approx(0.57, abs=1e-3)
    np.testing.assert_allclose(state.derived["qfrc_actuator"], data.qfrc_actuator, atol=1e-5)


def test_the_actuators_force_at_the_beginning_follows_from_their_states(bench: JittedEngine) -> None:
    qpos, qvel, _ = start(bench.model, 3)
    act = np.full(bench.model.na, 0.4, np.float32)
    data = mujoco.MjData(bench.model)
    data.qpos[:], data.qvel[:], data.act[:] = qpos[2], qvel[2], act
    mujoco.mj_forward(bench.model, data)
    assert np.abs(data.qfrc_actuator).max() > 0.1
    derived = bench.reset(qpos[2], qvel[2], act=jnp.asarray(act)).derived
    np.testing.assert_allclose(derived["qfrc_actuator"], data.qfrc_actuator, atol=1e-5)


def test_many_environments_move_as_each_would_alone(bench: JittedEngine) -> None:
    qpos, qvel, ctrl = start(bench.model, 3)
    together = bench.step_many(bench.reset_many(qpos, qvel), ctrl)
    for index in range(3):
        alone = bench.step(bench.reset(qpos[index], qvel[index]), ctrl[index])
        for one, other in zip(
            jax.tree.leaves(state_of(together, index)), jax.tree.leaves(alone), strict=True
        ):
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=bench.tolerance * 0.1)


@pytest.mark.parametrize("name", ["native", "compiled", *extra("warp")])
def test_environments_may_lie_on_two_axes(name: EngineName, request: pytest.FixtureRequest) -> None:
    # JAX itself sees to it for MJX; the other engines' callbacks are given both axes.
    if name == "warp":
        request.getfixturevalue("warp_kernels")
    model = mujoco.MjModel.from_xml_string(BODY)
    engine = engine_builder(name)(model, NUM_SUBSTEPS, ("xpos",))
    qpos, qvel, ctrl = start(model, 3)
    flat = jax.vmap(engine.step)(jax.vmap(engine.reset)(qpos, qvel), ctrl)
    qpos, qvel, ctrl = (jnp.stack([array, array]) for array in (qpos, qvel, ctrl))
    nested = jax.vmap(jax.vmap(engine.step))(jax.vmap(jax.vmap(engine.reset))(qpos, qvel), ctrl)
    for index in (0, 1):
        np.testing.assert_array_equal(nested.qpos[index], flat.qpos)
        np.testing.assert_array_equal(nested.derived["xpos"][index], flat.derived["xpos"])


def test_equal_arguments_give_equal_results_whatever_came_between(bench: JittedEngine) -> None:
    qpos, qvel, ctrl = start(bench.model, 3)
    state = bench.reset_many(qpos, qvel)
    first = bench.step_many(state, ctrl)
    bench.step_many(first, -ctrl)
    bench.reset_many(qpos[::-1], -qvel)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(bench.step_many(state, ctrl)), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("broken", ["a control that is not a number", "a speed past all reason"])
def test_an_environment_that_breaks_is_not_a_number_and_its_neighbours_do_not_mind(
    bench: JittedEngine, broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file where it stands
    qpos, qvel, ctrl = start(bench.model, 3)
    state = bench.reset_many(qpos, qvel)
    if broken.startswith("a control"):
        bad_state, bad_ctrl = state, ctrl.at[1].set(jnp.nan)
    else:
        bad_state, bad_ctrl = replace(state, qvel=state.qvel.at[1, 0].set(1e30)), ctrl
    fine = bench.step_many(state, ctrl)
    after = bench.step_many(bad_state, bad_ctrl)
    for again in (after, bench.step_many(after, ctrl)):
        # It stays broken: nothing puts it back to the beginning behind the caller's back.
        assert not np.isfinite(again.qvel[1]).all()
    for index in (0, 2):
        np.testing.assert_array_equal(after.qpos[index], fine.qpos[index])


@pytest.mark.parametrize("name", ["native", "compiled", *extra("warp")])
def test_several_threads_may_use_one_engine(name: EngineName, request: pytest.FixtureRequest) -> None:
    if name == "warp":
        request.getfixturevalue("warp_kernels")
    model = mujoco.MjModel.from_xml_string(BODY)
    engine = engine_builder(name)(model, NUM_SUBSTEPS, ("xpos",))
    step = jax.jit(jax.vmap(engine.step))
    qpos, qvel, ctrl = start(model, 3)
    states = [jax.vmap(engine.reset)(qpos, factor * qvel) for factor in (1.0, -1.0)]
    alone = [_after_steps(step, state, ctrl) for state in states]
    together: dict[int, PhysicsState] = {}

    def run(index: int) -> None:
        together[index] = _after_steps(step, states[index], ctrl)

    threads = [threading.Thread(target=run, args=(index,)) for index in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    for index in (0, 1):
        np.testing.assert_array_equal(together[index].qpos, alone[index].qpos)


def _after_steps(step: Callable[..., PhysicsState], state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
    for _ in range(50):
        state = step(state, ctrl)
    return jax.block_until_ready(state)


@pytest.mark.parametrize("name", ["native", "compiled"])
def test_a_program_with_physics_on_the_host_tells_its_model_and_nothing_of_its_process(
    name: EngineName,
) -> None:
    # JAX finds a kept program by its text: equal engines share it, engines that differ must not.
    def text(
        derived: tuple[str, ...] = ("xpos",), num_substeps: int = NUM_SUBSTEPS, mass: float = 1.0
    ) -> str:
        model = mujoco.MjModel.from_xml_string(BODY)
        model.body_mass[1] *= mass
        engine = engine_builder(name)(model, num_substeps, derived)
        qpos, qvel, ctrl = start(model, 3)
        step = jax.vmap(lambda qpos, qvel, ctrl: engine.step(engine.reset(qpos, qvel), ctrl))
        return jax.jit(step).lower(qpos, qvel, ctrl).as_text()

    assert text() == text()
    others = [text(mass=1.01), text(num_substeps=4), text(("xquat",)), text(())]
    assert len({text(), *others}) == 5


@pytest.mark.parametrize("name", ["native", "compiled"])
def test_engines_that_are_equal_or_not_may_live_side_by_side_and_die(name: EngineName) -> None:
    def stepped(mass: float) -> jax.Array:
        model = mujoco.MjModel.from_xml_string(BODY)
        model.body_mass[1] *= mass
        engine = engine_builder(name)(model, NUM_SUBSTEPS, ())
        qpos, qvel, ctrl = start(model, 3)
        return jax.jit(jax.vmap(engine.step))(jax.vmap(engine.reset)(qpos, qvel), ctrl).qvel

    light, heavy, again = stepped(1.0), stepped(5.0), stepped(1.0)
    np.testing.assert_array_equal(light, again)
    assert np.abs(light - heavy).max() > 1e-3


@pytest.fixture(scope="module")
def ant() -> mujoco.MjModel:
    model = brax_model("ant")
    model.opt.iterations, model.opt.ls_iterations = 8, 16
    return model


BODIES = [name for name, info in catalog.BUILT_IN.items() if not info.takes_model]
# Warp compiles kernels for some seconds, MJX its program for up to a minute, the rodent's for many; LLVM
# takes half a minute for a star's programs, of which a smaller one is tried at any time, and more for the
# rodent's.
COVERED = [body for body in BODIES if "compiled" not in catalog.BUILT_IN[body].cannot_run]
LONG = [body for body in COVERED if body.startswith("brittle_star") or body == "rodent"]
SMALL_STAR = {"num_arms": 3, "num_segments_per_arm": 2}
FIRST = ("compiled", "ant")
FAST = [
    ("mjx", "ant"),
    *(("warp", body) for body in ("ant", "humanoid", "rodent")),
    *(("compiled", body) for body in COVERED if body not in (*LONG, "ant")),
]
SLOW = [
    pytest.param(engine, body, marks=[pytest.mark.slow, pytest.mark.timeout(300)])
    for engine, bodies in (("mjx", BODIES), ("warp", BODIES), ("compiled", LONG))
    for body in bodies
    if (engine, body) not in [FIRST, *FAST, ("mjx", "rodent")]
]


@pytest.mark.parametrize(("name", "environment"), [FIRST, *extra(*FAST), *SLOW])
def test_the_engines_move_every_body_alike(
    name: EngineName, environment: str, request: pytest.FixtureRequest
) -> None:
    if name == "warp":
        request.getfixturevalue("warp_kernels")
    assert_moves_as_on_native(name, environment)


@pytest.mark.extra
def test_compiled_physics_moves_a_small_star_as_native_does() -> None:
    assert_moves_as_on_native("compiled", "brittle_star", **SMALL_STAR)


def assert_moves_as_on_native(name: EngineName, environment: str, **options: Any) -> None:
    # Under equal solver settings, converged, for ten control steps: long enough to land on the floor.
    ends = [_end_of_a_walk(engine, environment, options) for engine in ("native", name)]
    moved = np.abs(ends[0].qpos - ends[0].qpos[0]).max()
    assert moved > 0.05
    np.testing.assert_allclose(ends[1].qpos, ends[0].qpos, atol=2e-4)
    np.testing.assert_allclose(ends[1].qvel, ends[0].qvel, atol=5e-3)
    for field, values in ends[0].derived.items():
        np.testing.assert_allclose(ends[1].derived[field], values, rtol=1e-3, atol=5e-3, err_msg=field)


def _end_of_a_walk(name: EngineName, environment: str, options: dict[str, Any]) -> PhysicsState:
    """The environment's own model and fields on this engine, twice, under controls of their own."""
    made: list[tuple[Engine, mujoco.MjModel]] = []

    def build(
        model: mujoco.MjModel,
        num_substeps: int,
        derived: tuple[str, ...],
        *,
        accelerated: SolverSettings | None = None,
    ) -> Engine:
        model.opt.iterations, model.opt.ls_iterations = 30, 30
        made.append((engine_builder(name)(model, num_substeps, derived), model))
        return made[0][0]

    info, parsed = catalog.resolve(environment, options)
    catalog.make(info, parsed, build)
    engine, model = made[0]
    keys = jax.random.split(jax.random.key(3), 3)
    qpos = jnp.asarray(initial_qpos(model), jnp.float32) + 0.05 * jax.random.uniform(keys[0], (2, model.nq))
    qvel = 0.1 * jax.random.normal(keys[1], (2, model.nv))
    ctrl = jax.random.uniform(keys[2], (2, model.nu), minval=-0.3, maxval=0.3)

    def step(state: PhysicsState, _: None) -> tuple[PhysicsState, None]:
        return jax.vmap(engine.step)(state, ctrl), None

    state = jax.jit(jax.vmap(engine.reset))(qpos, qvel)
    return jax.jit(lambda state: jax.lax.scan(step, state, length=10))(state)[0]


def test_the_ant_settles_when_nothing_moves_it(ant: mujoco.MjModel) -> None:
    engine = engine_builder("native")(ant, 5, ())
    state = engine.reset(jnp.asarray(initial_qpos(ant), jnp.float32), jnp.zeros(ant.nv))
    state, _ = jax.jit(
        lambda state: jax.lax.scan(
            lambda state, _: (engine.step(state, jnp.zeros(8)), None), state, length=400
        )
    )(state)
    # Its stiff joints give way slowly. After 20 s it is still, its torso (a ball of 0.25 m) off the floor.
    assert float(jnp.abs(state.qvel).max()) < 1e-3
    assert 0.25 < float(state.qpos[2]) < 1.0
    assert float(state.time) == pytest.approx(20.0, abs=1e-3)


DELAYED = """
<mujoco>
  <option timestep="0.004"/>
  <worldbody>
    <body pos="0 0 1">
      <joint name="elbow" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>
    </body>
  </worldbody>
  <actuator><motor joint="elbow" delay="0.04" nsample="12"/></actuator>
  <sensor>
    <jointpos joint="elbow" delay="0.02" nsample="8"/>
    <jointvel joint="elbow" interval="0.012" nsample="2"/>
  </sensor>
</mujoco>
"""


def test_delays_are_part_of_the_state_to_the_last_bit() -> None:
    """Issue 41, o_act_delay and o_sensor_delay: without the history, and with a rounded time, a resumed run
    was another one."""
    model = mujoco.MjModel.from_xml_string(DELAYED)
    engine = engine_builder("native")(model, 5, ("sensordata",))
    step = jax.jit(jax.vmap(engine.step))
    state = jax.vmap(engine.reset)(jnp.zeros((2, 1)), jnp.zeros((2, 1)))
    data = mujoco.MjData(model)
    for ctrl in np.random.default_rng(0).uniform(-1, 1, 100).astype(np.float32):
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data, 5)
        for name in ("qpos", "qvel", "qacc_warmstart"):  # These are float32 between control steps.
            getattr(data, name)[:] = np.float32(getattr(data, name))
        # Stored and read again, as by a checkpoint.
        state = serialization.from_bytes(state, serialization.to_bytes(step(state, jnp.full((2, 1), ctrl))))
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(state.qpos[1], np.float32(data.qpos))
    np.testing.assert_array_equal(state.derived["sensordata"][1], np.float32(data.sensordata))
    np.testing.assert_array_equal(of_parts(np.asarray(state.exact["history"][1])), data.history)
    assert of_parts(np.asarray(state.exact["time"][1])) == data.time
    assert state.time[1] == np.float32(data.time)


def test_a_compiled_engine_s_late_controls_are_part_of_its_state() -> None:
    engine = engine_builder("compiled")(mujoco.MjModel.from_xml_string(DELAYED), 5, ())
    step = jax.jit(jax.vmap(engine.step))
    kept = read_again = jax.vmap(engine.reset)(jnp.zeros((2, 1)), jnp.zeros((2, 1)))
    for ctrl in np.random.default_rng(0).uniform(-1, 1, (20, 2, 1)).astype(np.float32):
        kept = step(kept, ctrl)
        read_again = serialization.from_bytes(kept, serialization.to_bytes(step(read_again, ctrl)))
    assert np.abs(kept.exact["history"]).max() > 0.5
    jax.tree.map(np.testing.assert_array_equal, kept, read_again)
