"""Brax's registered environments are what its package makes of them; what a step reads is carried."""

import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.environments import catalog
from core.environments.external.brax.environment import Brax, carried, load
from core.environments.external.brax.info import TABLE
from core.errors import JobFailed, Rejected
from core.jobs import checks
from core.jobs.spec import JOB_SPEC

NUM_ENVS = 3
pytestmark = pytest.mark.filterwarnings("ignore:Accessing:DeprecationWarning")  # Brax reads MJX by old names


def test_what_a_later_step_reads_is_carried_and_nothing_else() -> None:
    def step(state: list[Any], action: Any) -> tuple[list[Any], Any]:
        position, speed, _, count, unused = state
        # The result reads the position, that reads the speed; the third is only written, the count
        # only counts, and the last is only handed on.
        return [position + speed, speed + action, speed, count + 1, unused], position

    zero = jnp.zeros(())
    assert carried(step, [zero] * 5, zero) == [True, True, False, False, False]


def test_an_array_that_reaches_the_result_after_several_steps_is_carried() -> None:
    def step(state: list[Any]) -> tuple[list[Any], Any]:
        first, second, third = state
        return [second, third, third], first

    assert carried(step, [jnp.zeros(())] * 3) == [True, True, True]


def episodes(environment: Any, actions: jax.Array) -> Any:
    """The states [T, NUM_ENVS, ...] after each of the actions, from equal keys."""
    keys = jax.random.split(jax.random.PRNGKey(1), NUM_ENVS)

    @jax.jit
    def run(keys: jax.Array, actions: jax.Array) -> Any:
        def step(state: Any, action: jax.Array) -> tuple[Any, Any]:
            after = jax.vmap(environment.step)(state, action)
            return after, after

        return jax.lax.scan(step, jax.vmap(environment.reset)(keys), actions)[1]

    return run(keys, actions)


def test_a_state_holds_what_the_next_step_reads_and_keeps_its_form() -> None:
    pendulum = Brax("inverted_pendulum", "spring")
    before = jax.eval_shape(pendulum.reset, jax.random.PRNGKey(0))
    after = jax.eval_shape(pendulum.step, before, jnp.zeros(1))
    assert jax.tree.map(lambda x: (x.shape, x.dtype), before) == jax.tree.map(
        lambda x: (x.shape, x.dtype), after
    )
    kept = {name for name in after.info if name.startswith("pipeline/")}
    assert len(kept) < len(pendulum._names)
    assert {"pipeline/x.pos", "pipeline/xd.vel"} & kept or {"pipeline/x_i.pos", "pipeline/xd_i.vel"} <= kept


@pytest.mark.slow  # two programs of Brax's physics
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("name", "backend"),
    [
        ("inverted_pendulum", "spring"),
        ("ant", "generalized"),
        ("halfcheetah", "positional"),
        ("hopper", "mjx"),
        ("pusher", "generalized"),
    ],
)
def test_equal_keys_and_actions_give_what_the_package_gives(name: str, backend: str) -> None:
    ours, theirs = Brax(name, backend), load(name, backend)
    shape = (5, NUM_ENVS, ours.action_size)
    actions = jax.random.uniform(jax.random.PRNGKey(2), shape, minval=-1.0, maxval=1.0)
    states, their_states = episodes(ours, actions), episodes(theirs, actions)
    for field in ("obs", "reward", "done"):
        theirs_now = getattr(their_states, field)
        np.testing.assert_allclose(getattr(states, field), theirs_now, rtol=1e-4, atol=1e-4, err_msg=field)
    np.testing.assert_allclose(states.physics.qpos, their_states.pipeline_state.q, atol=1e-5)
    np.testing.assert_allclose(states.physics.time[-1], 5 * ours.dt, rtol=1e-5)


@pytest.mark.slow  # one more of Brax's bodies to compile
def test_a_step_after_an_end_does_not_end_again() -> None:
    # Brax leaves `done` as it finds it where nothing ends an episode; a length that cut one off set it.
    cheetah: Any = Brax("reacher", "spring")
    state = cheetah.reset(jax.random.PRNGKey(0))
    after = jax.jit(cheetah.step)(state.replace(done=jnp.ones(())), jnp.zeros(2))
    assert float(after.done) == 0.0


@pytest.mark.slow  # it builds all of them, under each physics
@pytest.mark.timeout(900)
def test_the_table_is_what_the_installed_package_does() -> None:
    from core.environments.external.brax.describe import table

    assert json.loads(TABLE.read_text()) == table()


def test_its_physics_is_chosen_by_an_option_and_by_no_engine() -> None:
    job = {"kind": "train", "environment": "brax/ant"}
    for extra, place in (
        ({"physics": "mjx"}, "/physics"),
        ({"physics": "compiled"}, "/physics"),
        (
            {"environment": {"id": "brax/ant", "options": {"backend": "bullet"}}},
            "/environment/options/backend",
        ),
        (
            {"randomization": [{"field": "opt.gravity", "axis": 2, "range": [0.9, 1.1]}]},
            "/randomization",
        ),
    ):
        with pytest.raises(Rejected) as refusal:
            checks.check(JOB_SPEC.validate_python(job | extra), None)  # type: ignore[arg-type]
        assert [problem.pointer for problem in refusal.value.problems] == [place]
    info = catalog.find("brax/inverted_pendulum")
    assert info.dt == pytest.approx(0.04)
    spring = info.under(info.options.model_validate({"backend": "spring"}))
    assert (spring.dt, spring.own_physics) == (pytest.approx(0.02), "brax spring")


@pytest.mark.extra
def test_environments_that_differ_are_beyond_its_physics() -> None:
    with pytest.raises(JobFailed, match="cannot randomize the model"):
        Brax("inverted_pendulum", "spring").reset(jax.random.PRNGKey(0), {"opt.gravity": jnp.zeros(3)})
