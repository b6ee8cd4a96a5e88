"""The rodent: the notebook's reward and observation over plain MuJoCo, and a body that stands."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog, optional_packages
from core.environments.dm_control.rodent.model import rodent_model
from core.environments.environment import State
from core.errors import JobFailed, Rejected
from core.physics import availability
from core.physics.availability import choose
from core.physics.capacity import capacity, measure
from core.physics.choose import engine_builder
from core.physics.model import initial_qpos

NUM_ACTUATORS = 38
STANDING_HEIGHT_M = 0.047


@dataclass(frozen=True)
class Case:
    model: mujoco.MjModel
    dt: float
    observation_size: int
    reset: Callable[[jax.Array], State]
    step: Callable[[State, jax.Array], State]


def build(**options: object) -> Case:
    info = catalog.find("rodent")
    environment = catalog.make(info, catalog.parse_options(info, options), engine_builder("native"))
    size = environment.observation_size
    assert isinstance(size, int)
    return Case(
        environment.model, environment.dt, size, jax.jit(environment.reset), jax.jit(environment.step)
    )


@pytest.fixture(scope="module")
def rodent() -> Case:
    return build()


def plain_step(model: mujoco.MjModel, state: State, action: jax.Array) -> mujoco.MjData:
    """Five physics steps of plain MuJoCo from the same state; then derived fields of the state reached."""
    data = mujoco.MjData(model)
    physics = state.physics
    data.qpos[:], data.qvel[:], data.act[:] = physics.qpos, physics.qvel, physics.act
    data.qacc_warmstart[:], data.ctrl[:] = physics.qacc_warmstart, action
    mujoco.mj_step(model, data, 5)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)
    return data


def test_rewards_and_observations_are_the_notebooks_over_plain_mujoco(rodent: Case) -> None:
    state = rodent.reset(jax.random.key(3))
    for index in range(5):
        action = jax.random.uniform(jax.random.key(index), (NUM_ACTUATORS,), minval=-1.0, maxval=1.0)
        before = np.asarray(state.physics.derived["subtree_com"][1])
        data = plain_step(rodent.model, state, action)
        state = rodent.step(state, action)
        velocity = (data.subtree_com[1] - before) / 0.01
        # The weights of the notebook: 5 for speed, 0.5 for being up, 0.1 for the action.
        terms = (5 * velocity[0], 0.5, -0.1 * np.sum(np.square(action)))
        np.testing.assert_allclose(state.reward, sum(terms), rtol=1e-4, atol=1e-4)
        names = ("forward_reward", "reward_alive", "reward_quadctrl")
        np.testing.assert_allclose([state.metrics[name] for name in names], terms, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(state.metrics["x_velocity"], velocity[0], atol=1e-4)
        np.testing.assert_allclose(state.metrics["height"], data.qpos[2], atol=1e-6)
        observed = (data.qpos, data.qvel, data.cinert[1:], data.cvel[1:], data.qfrc_actuator)
        expected = np.concatenate([field.ravel() for field in observed])
        np.testing.assert_allclose(state.obs, expected, rtol=1e-4, atol=1e-4)


def test_it_stands_where_it_is_put_when_it_does_nothing(rodent: Case) -> None:
    state = rodent.reset(jax.random.key(0))
    # The noise lifts it by up to 2 cm; half a second later it has landed.
    assert STANDING_HEIGHT_M - 1e-3 < float(state.physics.qpos[2]) < STANDING_HEIGHT_M + 0.021
    for _ in range(50):
        state = rodent.step(state, jnp.zeros(NUM_ACTUATORS))
    assert float(state.metrics["height"]) == pytest.approx(STANDING_HEIGHT_M, abs=2e-3)
    assert abs(float(state.metrics["x_velocity"])) < 0.02
    assert float(state.reward) == pytest.approx(0.5, abs=0.1)
    assert float(state.done) == 0


def test_on_its_back_its_episode_ends(rodent: Case) -> None:
    state = rodent.reset(jax.random.key(0))
    assert float(state.done) == 0
    # Half a turn about x, let go at 5 cm.
    upside_down = jnp.array([0.0, 0.0, 0.05, 0.0, 1.0, 0.0, 0.0])
    state = replace(state, physics=replace(state.physics, qpos=state.physics.qpos.at[:7].set(upside_down)))
    for _ in range(50):
        state = rodent.step(state, jnp.zeros(NUM_ACTUATORS))
    assert float(state.metrics["height"]) < 0.03
    assert float(state.done) == 1


def test_the_frames_and_the_timestep_of_an_action_are_options() -> None:
    case = build(n_frames=2, timestep=0.005, exclude_current_positions_from_observation=True)
    assert case.dt == pytest.approx(0.01)
    assert case.observation_size == 1258
    state = case.step(case.reset(jax.random.key(0)), jnp.zeros(NUM_ACTUATORS))
    np.testing.assert_array_equal(state.obs[:72], state.physics.qpos[2:])
    assert float(state.physics.time) == pytest.approx(0.01)


def test_everything_touches_the_floor_and_nothing_else() -> None:
    model = rodent_model(0.002)
    data = mujoco.MjData(model)
    data.qpos[:] = initial_qpos(model)
    random = np.random.default_rng(0)
    touching: set[str] = set()
    for _ in range(60):
        data.ctrl[:] = random.uniform(-1.0, 1.0, model.nu)
        mujoco.mj_step(model, data, 10)
        assert {int(contact.geom[0]) for contact in data.contact} <= {model.geom("floor").id}
        touching |= {model.geom(int(contact.geom[1])).name for contact in data.contact}
    for part in ("foot_L", "foot_R", "toe_L", "toe_R", "finger_L", "finger_R", "vertebra_C"):
        assert any(name.startswith(part) for name in touching), part
    # Paws grip with their own friction; the rest has the file's. Both slide in two directions.
    frictions = {model.geom(int(c.geom[1])).name: (c.friction[0], c.dim) for c in data.contact}
    assert set(frictions.values()) <= {(1.5, 3), (0.7, 3)}


def test_the_few_iterations_of_an_accelerator_move_it_as_many_do() -> None:
    # Newton's method 4 times, 8 steps of line search, from standing, for 0.1 s of random controls.
    ends = []
    for iterations, ls_iterations in ((100, 50), (4, 8)):
        model = rodent_model(0.002)
        model.opt.iterations, model.opt.ls_iterations = iterations, ls_iterations
        data = mujoco.MjData(model)
        data.qpos[:] = initial_qpos(model)
        data.ctrl[:] = np.random.default_rng(0).uniform(-1.0, 1.0, model.nu)
        mujoco.mj_step(model, data, 50)
        ends.append(np.array(data.qpos))
    assert np.abs(ends[0] - initial_qpos(model)).max() > 0.3
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-3)


@pytest.mark.extra
def test_buffers_of_warp_hold_a_rodent_that_falls_anyhow() -> None:
    model = rodent_model(0.002)
    room = capacity(measure(model, np.array([[0, geom] for geom in range(1, model.ngeom)])), 1)
    data = mujoco.MjData(model)
    random = np.random.default_rng(5)
    for _ in range(4):
        mujoco.mj_resetData(model, data)
        # Any pose within its joints' limits, any way up, let go at 15 cm.
        data.qpos[7:] = random.uniform(*model.jnt_range[1:].T)
        data.qpos[2], data.qpos[3:7] = 0.15, random.standard_normal(4)
        for _ in range(100):
            data.ctrl[:] = random.choice([-1.0, 1.0], model.nu)
            mujoco.mj_step(model, data, 5)
            assert data.ncon < room.naconmax
            assert data.nefc < room.njmax


def test_a_gpu_gets_the_fastest_that_is_there_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for missing, engine in (
        (set[str](), "compiled"),
        ({"compiled"}, "warp"),
        ({"compiled", "warp"}, "native"),
    ):
        monkeypatch.setattr(availability, "is_installed", lambda name, gone=missing: name not in gone)
        assert choose("auto", "gpu", 2048, catalog.find("rodent").on_a_gpu).name == engine


def test_a_worker_without_dm_control_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(optional_packages, "find_spec", lambda _: None)
    with pytest.raises(JobFailed, match="uv sync --inexact --extra dm-control") as failure:
        build()
    assert failure.value.reason == "bad_model"


def test_too_few_iterations_for_it_are_refused() -> None:
    with pytest.raises(Rejected, match=r"iterations: .*greater than or equal to 3"):
        catalog.parse_options(catalog.find("rodent"), {"iterations": 2})
