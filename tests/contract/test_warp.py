"""What only the engine `warp` does: it counts what it loses, keeps quiet, and runs whole trainings."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.errors import JobFailed
from core.physics.capacity import Capacity
from core.physics.choose import engine_builder
from core.physics.engine import OVERFLOW, PhysicsState
from tests.learning.runs import STEPS_PER_UPDATE, checkpoints, small_run

# A ball that rests on the floor has one contact, which is four constraint rows.
BALL = """
<mujoco>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body pos="0 0 1"><freejoint/><geom type="sphere" size="0.1"/></body>
  </worldbody>
</mujoco>
"""
ON_THE_FLOOR, IN_THE_AIR = 0.099, 1.0

pytestmark = [pytest.mark.extra, pytest.mark.usefixtures("warp_kernels")]


def balls(heights: list[float], room: Capacity | None, monkeypatch: pytest.MonkeyPatch) -> PhysicsState:
    """Balls let go at these heights, after one control step, in buffers of this size."""
    if room is not None:
        monkeypatch.setattr("core.physics.warp_buffers.capacity", lambda demand, num_worlds: room)
    model = mujoco.MjModel.from_xml_string(BALL)
    engine = engine_builder("warp")(model, 1, ("xpos",))
    qpos = jnp.asarray([[0, 0, height, 1, 0, 0, 0] for height in heights], jnp.float32)
    state = jax.vmap(engine.reset)(qpos, jnp.zeros((len(heights), 6)))
    assert not np.any(state.derived[OVERFLOW])
    return jax.vmap(engine.step)(state, jnp.zeros((len(heights), 0)))


def test_nothing_is_lost_in_the_room_that_a_trial_asks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    state = balls([ON_THE_FLOOR] * 3, None, monkeypatch)
    np.testing.assert_array_equal(state.derived[OVERFLOW], [0, 0, 0])


def test_a_world_that_lost_constraint_rows_says_so(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    # Rows are counted in each world: 3 are too few for the ball on the floor alone.
    state = balls([IN_THE_AIR, ON_THE_FLOOR, IN_THE_AIR], Capacity(naconmax=8, njmax=3), monkeypatch)
    np.testing.assert_array_equal(state.derived[OVERFLOW], [0, 1, 0])
    assert np.isfinite(state.qpos).all()
    written = capfd.readouterr()
    assert "overflow" not in written.out + written.err


def test_a_buffer_of_contacts_that_is_full_marks_every_world(monkeypatch: pytest.MonkeyPatch) -> None:
    # Contacts are counted over all worlds: nobody can tell whose is the one that is lost.
    state = balls([ON_THE_FLOOR, ON_THE_FLOOR, IN_THE_AIR], Capacity(naconmax=1, njmax=24), monkeypatch)
    np.testing.assert_array_equal(state.derived[OVERFLOW], [1, 1, 1])


def test_a_world_that_is_broken_takes_no_room_and_claims_no_overflow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A ball in the model's own initial position, which is in the air, is moved in its place.
    state = balls([jnp.nan, ON_THE_FLOOR], Capacity(naconmax=1, njmax=24), monkeypatch)
    assert np.isnan(state.qpos[0]).all()
    assert np.isfinite(state.qpos[1]).all()
    np.testing.assert_array_equal(state.derived[OVERFLOW], [0, 0])


def test_a_model_that_warp_cannot_run_ends_the_job_with_the_reason() -> None:
    model = mujoco.MjModel.from_xml_string(BALL.replace("<mujoco>", "<mujoco><option integrator='RK4'/>"))
    model.opt.solver = mujoco.mjtSolver.mjSOL_PGS
    with pytest.raises(JobFailed, match=r"MuJoCo Warp cannot run this model: .*PGS") as failure:
        engine_builder("warp")(model, 1, ())
    assert failure.value.reason == "bad_model"


@pytest.mark.slow
def test_a_training_resumed_on_warp_equals_an_uninterrupted_one() -> None:
    # On a CPU; on a GPU contacts are found in no fixed order, and sums are rounded differently.
    info = catalog.find("ant")
    environment = catalog.make(info, info.options(), engine_builder("warp"))
    budget = {"num_timesteps": 4 * STEPS_PER_UPDATE, "episode_length": 5, "num_evals": 0}
    straight = checkpoints(
        small_run(environment, checkpoint_every_steps=2 * STEPS_PER_UPDATE, epoch_s=0.0, **budget)
    )
    resumed = small_run(environment, resume=straight[2 * STEPS_PER_UPDATE], **budget)
    assert checkpoints(resumed) == {4 * STEPS_PER_UPDATE: straight[4 * STEPS_PER_UPDATE]}


@pytest.mark.gpu
def test_on_a_gpu_a_replayed_graph_does_what_its_first_run_did() -> None:
    # Each number of worlds has a graph of its own, captured after a first run without one.
    info = catalog.find("ant")
    warp = catalog.make(info, info.options(), engine_builder("warp"))
    for num_worlds in (64, 8):
        state = jax.vmap(warp.reset)(jax.random.split(jax.random.key(0), num_worlds))
        step = jax.jit(jax.vmap(warp.step))
        actions = jnp.linspace(-1.0, 1.0, num_worlds * 8).reshape(num_worlds, 8)
        first = step(state, actions)
        for _ in range(3):
            again = step(state, actions)
            np.testing.assert_allclose(again.obs, first.obs, atol=1e-4)
        assert np.abs(first.obs - state.obs).max() > 0.1
        assert not np.any(again.physics.derived[OVERFLOW])
