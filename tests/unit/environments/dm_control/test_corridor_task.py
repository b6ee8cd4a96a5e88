"""The corridor as dm_control's task: its reward, endings, observables and looks, against dm_control's own."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.environments.dm_control.corridor.environment import Corridor
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import corridor_model
from core.environments.dm_control.corridor.rewards import linear_tolerance
from core.environments.dm_control.corridor.termination import Endings
from core.environments.dm_control.corridor.walkers import Walker
from core.environments.dm_control.dm_control_import import without_a_display
from core.environments.environment import State
from core.errors import Rejected
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from core.physics.engine import PhysicsState
from core.physics.model import initial_qpos

WHOLE: dict[str, Any] = {
    "arena": "empty",
    "corridor_length": 12,
    "terminate_when_unhealthy": False,
    "target_velocity": 2.0,
    "target_velocity_weight": 3.0,
    "contact_termination": True,
    "terminate_at_height": -0.3,
    # In another order than they are observed.
    "observables": ["qfrc_actuator", "cinert", "cvel"],
}


def dm_control(name: str) -> Any:
    with without_a_display():
        return import_module(f"dm_control.{name}")


def made(options: dict[str, Any], engine: EngineName = "native") -> Corridor:
    info = catalog.find("corridor")
    environment = catalog.make(info, catalog.parse_options(info, options), engine_builder(engine))
    assert isinstance(environment, Corridor)
    return environment


@cache
def whole() -> tuple[Corridor, Callable[[jax.Array], State], Callable[[State, jax.Array], State]]:
    environment = made(WHOLE)
    return environment, jax.jit(environment.reset), jax.jit(environment.step)


def refusal(**options: object) -> str:
    with pytest.raises(Rejected) as refused:
        catalog.parse_options(catalog.find("corridor"), options)
    return refused.value.detail


@pytest.mark.parametrize(
    ("velocity", "worth"),
    # 1 m/s away of 2: a half. At rest, at twice the target and backwards: nothing.
    [(2.0, 1.0), (1.0, 0.5), (3.0, 0.5), (0.5, 0.25), (0.0, 0.0), (4.0, 0.0), (9.0, 0.0), (-1.0, 0.0)],
)
def test_the_target_velocity_is_worth_one_and_half_of_it_a_half(velocity: float, worth: float) -> None:
    assert float(linear_tolerance(jnp.float32(velocity), 2.0, margin=2.0)) == worth


def test_the_tolerance_is_dm_controls() -> None:
    theirs = dm_control("utils.rewards").tolerance
    speeds = np.linspace(-2.0, 9.0, 111, dtype=np.float32)
    for target in (0.3, 1.0, 3.0):
        ours = jax.vmap(lambda speed, target=target: linear_tolerance(speed, target, margin=target))
        expected = theirs(speeds, (target, target), margin=target, sigmoid="linear", value_at_margin=0.0)
        np.testing.assert_allclose(ours(jnp.asarray(speeds)), expected, atol=2e-6)


def test_a_step_earns_the_weighted_worth_of_its_speed_besides_the_rest() -> None:
    _, reset, step = whole()
    state = reset(jax.random.key(0))
    assert float(state.metrics["reward_target_velocity"]) == 0.0
    physics = replace(state.physics, qvel=state.physics.qvel.at[0].set(0.5))
    after = step(replace(state, physics=physics), jnp.zeros(8))
    speed = float(after.metrics["x_velocity"])
    assert 0.2 < speed < 0.6
    assert float(after.metrics["reward_target_velocity"]) == pytest.approx(3.0 * speed / 2.0, rel=1e-5)
    names = ("forward_reward", "distance_reward", "reward_alive", "reward_quadctrl", "reward_target_velocity")
    assert float(after.reward) == pytest.approx(sum(float(after.metrics[name]) for name in names), rel=1e-5)


def test_the_observation_has_the_fields_that_the_notebook_left_out() -> None:
    environment, reset, step = whole()
    state = reset(jax.random.key(1))
    action = jax.random.uniform(jax.random.key(2), (8,), minval=-1.0, maxval=1.0)
    data = mujoco.MjData(environment.model)
    data.qpos[:], data.qvel[:] = state.physics.qpos, state.physics.qvel
    data.qacc_warmstart[:], data.ctrl[:] = state.physics.qacc_warmstart, action
    mujoco.mj_step(environment.model, data, 5)
    forces = np.array(data.qfrc_actuator)
    mujoco.mj_kinematics(environment.model, data)
    mujoco.mj_comPos(environment.model, data)
    mujoco.mj_comVel(environment.model, data)
    # Of the walker's 13 bodies; the world, the walls and the frame that carries the walker never change.
    [trunk] = [
        body for body in range(environment.model.nbody) if environment.model.body(body).name == "walker/torso"
    ]
    fields = [data.cinert[trunk:].ravel(), data.cvel[trunk:].ravel(), forces]
    assert [field.size for field in fields] == [130, 78, 14]
    expected = np.concatenate([data.qpos[2:], data.qvel, *fields])
    observed = step(state, action).obs
    np.testing.assert_allclose(observed, expected, rtol=1e-3, atol=1e-3)
    info = catalog.find("corridor")
    row = info.under(catalog.parse_options(info, WHOLE))
    assert row.observation_size == environment.observation_size == observed.size == expected.size


def test_an_episode_ends_where_the_trunk_touches_the_ground_or_a_foot_is_too_low() -> None:
    _, reset, step = whole()
    state = reset(jax.random.key(0))
    still = step(state, jnp.zeros(8))
    assert float(still.done) == 0.0
    # The torso is a ball of 0.25 m, and touches at 0.2 m. 0.9 m below the ground, so are the feet.
    for lowered, name in ((0.16, "nonfoot_contact"), (1.26, "end_effector_too_low")):
        physics = replace(state.physics, qpos=state.physics.qpos.at[2].add(-lowered))
        after = step(replace(state, physics=physics), jnp.zeros(8))
        assert float(after.metrics[name]) == 1.0
        assert float(after.done) == 1.0
        assert float(still.metrics[name]) == 0.0


def test_what_is_not_asked_for_is_neither_computed_nor_reported() -> None:
    environment = made({"arena": "empty", "corridor_length": 12})
    assert environment.model.nsensor == 0
    state = jax.eval_shape(environment.reset, jax.random.key(0))
    assert set(state.physics.derived) == {"subtree_com", "xpos"}
    added = {"reward_target_velocity", "nonfoot_contact", "end_effector_too_low"}
    assert not added & set(state.metrics)


@pytest.mark.parametrize(
    ("walker", "arena", "lower"),
    [
        ("ant", "empty", 0.4),
        ("ant", "gaps", 0.4),
        ("ant", "walls", 0.4),
        ("humanoid", "gaps", 0.7),
        # Its head is 0.44 m above the ground.
        ("rolling_ball", "gaps", 1.2),
    ],
)
def test_contacts_end_an_episode_where_they_would_in_dm_control(
    walker: Walker, arena: Any, lower: float
) -> None:
    options = CorridorOptions(walker=walker, arena=arena, contact_termination=True, corridor_length=12)
    model = corridor_model(options)
    endings, theirs = Endings(model, options), disallowed(model, walker)
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    ours, expected = list[float](), list[bool]()
    for _ in range(40):
        data.qpos[:] = initial_qpos(model)
        # In the middle or at a side, which is 2.5 m away; if it can turn, in any direction.
        data.qpos[1] = random.choice([0.0, 2.4])
        data.qpos[2] += random.uniform(-lower, 1.0)
        if model.nq > 7:
            data.qpos[3:7] = random.normal(size=4)
        mujoco.mj_forward(model, data)
        ours.append(float(endings(having_found(data))["nonfoot_contact"]))
        expected.append(any(theirs(contact) for contact in data.contact))
    assert ours == expected
    assert 4 <= sum(expected) <= 36


def disallowed(model: mujoco.MjModel, walker: Walker) -> Callable[[Any], bool]:
    """dm_control's own rule, over the geoms of our model that it names."""
    made_ = {
        "ant": lambda: dm_control("locomotion.walkers.ant").Ant(),
        "humanoid": lambda: dm_control(
            "locomotion.walkers.cmu_humanoid"
        ).CMUHumanoidPositionControlledV2020(),
        "rolling_ball": lambda: dm_control("locomotion.walkers.jumping_ball").RollingBallWithHead(),
    }[walker]()
    feet = {f"walker/{geom.name}" for geom in made_.ground_contact_geoms}
    geoms = [model.geom(number) for number in range(model.ngeom)]
    body_of = [model.body(model.geom_bodyid[number]).name for number in range(model.ngeom)]
    parts = {geom.id for geom in geoms if body_of[geom.id].startswith("walker/") and geom.name not in feet}
    # Its corridors call the floor, or the platforms, ground; the sides' planes stand upright.
    floors = {
        geom.id
        for geom in geoms
        if body_of[geom.id] == "ground" or (body_of[geom.id] == "world" and abs(geom.quat[0]) > 0.9)
    }
    rule = dm_control("locomotion.tasks.corridors").RunThroughCorridor._is_disallowed_contact
    task = SimpleNamespace(_walker_nonfoot_geomids=parts, _ground_geomids=floors)
    return lambda contact: bool(rule(task, contact))


def having_found(data: mujoco.MjData) -> PhysicsState:
    """A state with what the sensors read."""
    return PhysicsState(
        *(jnp.zeros(0) for _ in range(5)), derived={"sensordata": jnp.asarray(data.sensordata, jnp.float32)}
    )


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "warp", "compiled"])
@pytest.mark.parametrize("arena", ["empty", "gaps"])
def test_every_engine_finds_the_contacts_that_native_finds(engine: EngineName, arena: str) -> None:
    options = {**WHOLE, "arena": arena, "terminate_at_height": None, "observables": []}
    found = list[list[float]]()
    for name in ("native", engine):
        environment = made(options, name)
        reset, step = jax.jit(jax.vmap(environment.reset)), jax.jit(jax.vmap(environment.step))
        state = reset(jax.random.split(jax.random.key(0), 8))
        # Its torso, a ball of 0.25 m whose middle is 0.52 m above its joint, 0.12 to 0.62 m above the
        # ground, in the middle and beside a side.
        height, y = jnp.linspace(-0.4, 0.1, 8), jnp.tile(jnp.array([0.0, 2.3]), 4)
        qpos = state.physics.qpos.at[:, 2].set(height).at[:, 1].set(y)
        state = replace(state, physics=replace(state.physics, qpos=qpos))
        found.append(step(state, jnp.zeros((8, 8))).metrics["nonfoot_contact"].tolist())
    assert found[0] == found[1]
    assert 0 < sum(found[0]) < len(found[0])


@pytest.mark.extra
def test_the_looks_change_no_physics() -> None:
    models = {
        look: corridor_model(CorridorOptions(aesthetic=look, corridor_length=12))
        for look in ("checkered", "default", "outdoor_natural")
    }
    plain = models["checkered"]
    fields = [name for name in dir(plain) if isinstance(getattr(plain, name), np.ndarray)]
    drawn = ("_sizes", "tex_", "mat_", "name", "path", "geom_matid", "geom_rgba")
    moved = [name for name in fields if not name.startswith(drawn)]
    assert {"body_mass", "geom_size", "geom_friction", "qpos0", "numeric_data"} <= set(moved)
    for model in models.values():
        for name in moved:
            np.testing.assert_array_equal(getattr(model, name), getattr(plain, name), err_msg=name)
        assert (model.opt.timestep, model.opt.cone, model.stat.extent) == (0.002, plain.opt.cone, 4.0)


def test_the_looks_are_drawn() -> None:
    skybox, grass = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtTexture.mjTEXTURE_2D
    for arena in ("empty", "gaps", "walls"):
        model = corridor_model(CorridorOptions(aesthetic="outdoor_natural", arena=arena, corridor_length=12))
        sizes = {int(model.tex_type[i]): int(model.tex_width[i]) for i in range(model.ntex)}
        # dm_control's pictures: four faces of the sky side by side, 2048 pixels wide, and grass of 512.
        assert (sizes[int(skybox)], sizes[int(grass)]) == (512, 512)
        ground = [
            g for g in map(model.geom, range(model.ngeom)) if model.geom_bodyid[g.id] < 3 and g.matid[0] >= 0
        ]
        assert {model.mat(geom.matid[0]).name for geom in ground} == {"ground"}


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"aesthetic": "sunset"}, "aesthetic: Input should be 'checkered', 'default' or 'outdoor_natural'"),
        # dm_control's own check looks for a part of the name, and lets this pass.
        ({"aesthetic": "outdoor"}, "aesthetic: Input should be 'checkered', 'default' or 'outdoor_natural'"),
        ({"target_velocity": 0}, "target_velocity: Input should be greater than 0"),
        ({"terminate_at_height": 0.5}, "terminate_at_height: Input should be less than or equal to 0"),
        ({"observables": ["mass"]}, "Input should be 'cinert', 'cvel' or 'qfrc_actuator'"),
        ({"walker": "rodent", "contact_termination": True}, "the rodent stands on its forearms"),
    ],
)
def test_what_the_task_does_not_have_is_refused(options: dict[str, object], sentence: str) -> None:
    assert sentence in refusal(**options)


def test_the_rodent_would_end_as_it_begins_in_dm_control_too() -> None:
    model = corridor_model(CorridorOptions(walker="rodent", arena="empty", corridor_length=10))
    data = mujoco.MjData(model)
    data.qpos[:] = initial_qpos(model)
    mujoco.mj_forward(model, data)
    feet = {
        f"walker/{geom.name}" for geom in dm_control("locomotion.walkers.rodent").Rat().ground_contact_geoms
    }
    touching = {model.geom(geom).name for contact in data.contact for geom in contact.geom}
    assert {"walker/radius_L_collision", "walker/radius_R_collision"} <= touching - feet
