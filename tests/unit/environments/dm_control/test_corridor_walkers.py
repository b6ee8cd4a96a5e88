"""The table of walkers against dm_control: all that it has are offered, or refused with a reason."""

import json
from collections.abc import Iterator
from importlib import import_module
from inspect import isabstract
from pkgutil import iter_modules
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog, describe_bodies
from core.environments.dm_control.corridor.environment import Corridor, holding_controls
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import corridor_model
from core.environments.dm_control.corridor.walkers import NOT_OFFERED, WALKERS, Walker
from core.environments.dm_control.dm_control_import import without_a_display
from core.environments.terms.inventory import TABLE
from core.errors import Rejected
from core.physics.choose import engine_builder
from core.physics.model import initial_qpos
from tests.extra import extra

# The classes that no corridor has, by the names under which they are refused. "dog" is no class.
REFUSED = {"FruitFly": "fruitfly", "BoxHead": "box_head", "Humanoid": "soccer_humanoid"}


def module(name: str) -> Any:
    with without_a_display():
        return import_module(f"dm_control.locomotion.{name}")


def walker_classes() -> Iterator[type[Any]]:
    """Every walker of dm_control's that is not abstract, each where it is defined."""
    base = module("walkers.base").Walker
    for folder in ("walkers", "soccer"):
        for found in iter_modules(module(folder).__path__):
            if found.ispkg or found.name.endswith("_test"):
                continue
            home = module(f"{folder}.{found.name}")
            for one in vars(home).values():
                is_walker = isinstance(one, type) and issubclass(one, base) and not isabstract(one)
                if is_walker and one.__module__ == home.__name__:
                    yield one


def made(walker: Walker) -> Any:
    home, _, name = WALKERS[walker].source.removeprefix("dm_control.locomotion.").partition(":")
    return getattr(module(home), name)()


def test_every_walker_of_dm_control_is_offered_or_refused_by_name() -> None:
    offered = {info.source.partition(":")[2] for info in WALKERS.values()}
    assert {one.__name__ for one in walker_classes()} == offered | set(REFUSED)
    assert set(NOT_OFFERED) == {*REFUSED.values(), "dog"}


def test_the_walkers_that_are_not_offered_are_what_their_reasons_say() -> None:
    fly = module("walkers.fruitfly_v2").FruitFly().mjcf_model
    # In cm/s², and every 0.1 ms.
    assert fly.option.gravity[2] == -981
    assert fly.option.timestep == 1e-4
    soccer = module("soccer.humanoid").Humanoid
    assert soccer.__bases__ == (module("walkers.cmu_humanoid").CMUHumanoidPositionControlled,)
    head, ball = (
        made_.mjcf_model.find_all("joint")
        for made_ in (module("soccer.boxhead").BoxHead(), made("jumping_ball"))
    )
    assert [joint.name for joint in head] == [joint.name for joint in ball]


@pytest.mark.parametrize("walker", sorted(NOT_OFFERED))
def test_a_walker_that_is_not_offered_is_refused_with_its_reason(walker: str) -> None:
    with pytest.raises(Rejected) as refused:
        catalog.parse_options(catalog.find("corridor"), {"walker": walker})
    assert NOT_OFFERED[walker] in refused.value.detail
    assert "rolling_ball" in refused.value.detail
    assert refused.value.problems[0].pointer.endswith("/walker")


@pytest.mark.parametrize("walker", ["ant", *extra(*(walker for walker in WALKERS if walker != "ant"))])
def test_a_row_is_what_dm_control_composes(walker: Walker) -> None:
    info, theirs = WALKERS[walker], made(walker)
    model = corridor_model(CorridorOptions(walker=walker, arena="empty", corridor_length=10))
    assert describe_bodies.walker(walker) == json.loads(TABLE.read_text())[f"corridor/{walker}"]
    trunk = model.body(info.trunk).id
    # Bodies come in the order of a depth-first search, and the walker is the last part of the world.
    assert (model.body_rootid[trunk:] == model.body_rootid[trunk]).all()
    assert info.trunk == f"walker/{theirs.root_body.name}"
    assert {f"walker/{part.name}" for part in theirs.end_effectors} == set(info.end_effectors)
    assert _foot_geoms(model, info.feet) == {f"walker/{geom.name}" for geom in theirs.ground_contact_geoms}


@pytest.mark.parametrize("walker", ["ant", *extra(*(walker for walker in WALKERS if walker != "ant"))])
def test_it_begins_where_the_table_says_and_is_healthy_there(walker: Walker) -> None:
    info = WALKERS[walker]
    model = corridor_model(CorridorOptions(walker=walker, arena="empty", corridor_length=10))
    data = mujoco.MjData(model)
    data.qpos[:] = initial_qpos(model)
    mujoco.mj_forward(model, data)
    assert data.body(info.trunk).xpos[2] == pytest.approx(info.standing_height, abs=0.005)
    assert data.qpos[0] == pytest.approx(5.0)
    if info.settles:
        mujoco.mj_step(model, data, 250)
        assert data.body(info.trunk).xpos[2] == pytest.approx(info.standing_height, abs=0.01)
    else:
        # It falls within 3 s, and what lies is not healthy.
        mujoco.mj_step(model, data, 1500)
        assert data.body(info.trunk).xpos[2] < 0.2 < info.healthy_z_range[0]


@pytest.mark.parametrize(
    ("walker", "least", "most"), [("jumping_ball", 0.9, 2.0), ("rolling_ball", 0.59, 0.61)]
)
def test_one_ball_jumps_and_both_roll_forward(walker: Walker, least: float, most: float) -> None:
    model = corridor_model(CorridorOptions(walker=walker, arena="empty"))
    data = mujoco.MjData(model)
    data.qpos[:] = initial_qpos(model)
    # Its actuator turns it backwards; the kick lifts it by 0.4 m of its slide, and throws it higher.
    data.actuator("walker/roll").ctrl[:] = -1.0
    highest = 0.0
    for number in range(1000):
        if walker == "jumping_ball":
            data.actuator("walker/kick").ctrl[:] = number // 250 % 2
        mujoco.mj_step(model, data)
        highest = max(highest, float(data.body("walker/head_body").xpos[2]))
    assert data.qpos[0] > 6.0
    assert least < highest < most


@pytest.mark.extra
@pytest.mark.parametrize("walker", ["humanoid", "humanoid_2019"])
def test_a_humanoid_with_servos_stands_on_for_a_second_under_actions_of_0(walker: Walker) -> None:
    assert steps_until_it_falls(walker) > 100
    # Control 0 is the middle of each joint's range: thighs at -70 degrees, knees at 85. It squats.
    assert 20 < steps_until_it_falls(walker, zero_action="middle") < 40


def steps_until_it_falls(walker: Walker, **options: Any) -> int:
    """Control steps of 0.01 s under actions of 0."""
    environment = corridor(walker, **options)
    state, step = environment.reset(jax.random.key(0)), jax.jit(environment.step)
    number = 0
    while not state.done:
        state, number = step(state, jnp.zeros(environment.action_size)), number + 1
    return number


def test_an_action_of_the_humanoid_is_added_to_the_control_that_holds_its_start() -> None:
    model = corridor_model(CorridorOptions(walker="humanoid", arena="empty"))
    held = holding_controls(model, initial_qpos(model))
    # A thigh goes from -160 to 20 degrees, so 0 is 70 of 90 degrees above the middle; a knee from 1 to 170.
    thigh, knee = model.actuator("walker/lfemurrx").id, model.actuator("walker/ltibiarx").id
    np.testing.assert_allclose([held[thigh], held[knee]], [70 / 90, -1.0], atol=1e-5)
    environment = corridor("humanoid")
    start = environment.reset(jax.random.key(0)).physics
    # The servos' filters begin there, so that nothing pulls as the episode begins.
    np.testing.assert_allclose(start.act, held, atol=1e-6)
    action = np.full(model.nu, 0.5, np.float32)
    got = environment.step(environment.reset(jax.random.key(0)), jnp.asarray(action)).physics
    expected = environment.engine.step(start, jnp.clip(held + action, -1.0, 1.0))
    np.testing.assert_array_equal(got.qpos, expected.qpos)


def test_a_humanoid_that_begins_sees_that_no_servo_pulls() -> None:
    state = corridor("humanoid", observables=["qfrc_actuator"]).reset(jax.random.key(0))
    np.testing.assert_array_equal(state.obs[-62:], np.zeros(62))


@pytest.mark.parametrize("walker", ["ant", *extra("rodent", "humanoid_2019_torque", "rolling_ball")])
def test_an_action_of_the_others_is_their_control(walker: Walker) -> None:
    environment = corridor(walker)
    start = environment.reset(jax.random.key(0))
    action = jnp.full(environment.action_size, 0.5)
    expected = environment.engine.step(start.physics, action)
    np.testing.assert_array_equal(environment.step(start, action).physics.qpos, expected.qpos)


def test_the_control_of_a_torque_that_holds_a_pose_is_0() -> None:
    model = corridor_model(CorridorOptions(walker="humanoid_2019_torque", arena="empty"))
    np.testing.assert_array_equal(holding_controls(model, initial_qpos(model)), np.zeros(56))


def corridor(walker: Walker, **options: Any) -> Corridor:
    info, parsed = catalog.resolve("corridor", {"walker": walker, "arena": "empty", **options})
    environment = catalog.make(info, parsed, engine_builder("native"))
    assert isinstance(environment, Corridor)
    return environment


def _foot_geoms(model: mujoco.MjModel, feet: tuple[str, ...]) -> set[str]:
    carried = np.zeros(model.nbody, bool)
    for body in range(model.nbody):
        carried[body] = model.body(body).name in feet or (body > 0 and carried[model.body_parentid[body]])
    return {model.geom(geom).name for geom in range(model.ngeom) if carried[model.geom_bodyid[geom]]}
