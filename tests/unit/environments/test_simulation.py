"""What a simulation says of a body gives its environment's own observation, in MuJoCo alone."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from core.environments import catalog
from core.environments.mujoco_env import MujocoEnv
from core.environments.numbers import (
    NUM_AHEAD,
    OBSTACLES_AHEAD,
    PREVIOUS_ACTION,
    SHARE_VELOCITY,
    Ends,
    NotSimulated,
    Numbers,
)
from core.environments.simulation import Simulation, as_xml
from core.physics.choose import engine_builder
from tests.extra import extra

BODIES = ["ant", "half_cheetah", "hopper", "humanoid", "inverted_pendulum", "walker2d"]
NUM_ENVS, NUM_STEPS = 20, 10

CART = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="cart" pos="0 0 1">
      <freejoint/>
      <geom type="box" size="0.2 0.1 0.1" mass="2"/>
      <body name="arm" pos="0.2 0 0">
        <joint name="elbow" type="hinge" axis="0 1 0" range="-1 1" limited="true" damping="0.1"/>
        <geom name="hand" type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="elbow" joint="elbow" ctrlrange="-1 3" ctrllimited="true" gear="0.5"/></actuator>
  <sensor><gyro site="none" name="gyro"/></sensor>
</mujoco>
""".replace('<geom type="box"', '<site name="none"/><geom type="box"')
SEEN = [
    {"kind": "qpos"},
    {"kind": "qvel"},
    {"kind": "previous_action"},
    {"kind": "sensors"},
    {"kind": "body_positions", "relative": True},
    {"kind": "body_orientations", "bodies": ["arm"]},
    {"kind": "cvel", "bodies": ["arm", "cart"]},
    {"kind": "cinert"},
    {"kind": "qfrc_actuator"},
]
ENDS = [{"kind": "upright", "least": 0.2}, {"kind": "contact", "geoms": ["hand"]}]


def of_the_catalog(name: str, options: Mapping[str, Any] | None = None, engine: Any = "native") -> MujocoEnv:
    info, read = catalog.resolve(name, options or {})
    made = catalog.make(info, read, engine_builder(engine))
    assert isinstance(made, MujocoEnv)
    return made


def of_a_user(folder: Path, text: str = CART, **options: Any) -> MujocoEnv:
    file = folder / "model.xml"
    file.write_text(text)
    info, read = catalog.resolve("mjcf", {"model": "sha256:" + "0" * 64, **options})
    made = catalog.make(info, read, engine_builder("native"), file)
    assert isinstance(made, MujocoEnv)
    return made


def read(
    numbers: Numbers, simulation: Simulation, model: mujoco.MjModel, data: mujoco.MjData, action: Any
) -> NDArray[np.float64]:
    """The numbers [n], as docs/push.md describes them."""
    if numbers.array == PREVIOUS_ACTION:
        array = np.asarray(action, float)
    elif numbers.array == OBSTACLES_AHEAD:
        array = ahead(simulation, *data.qpos[:2])
    elif numbers.array == SHARE_VELOCITY:
        mass = np.maximum(data.cinert[:, 9:], 1e-9)
        own = data.cvel[:, 3:] + np.cross(data.cvel[:, :3], data.cinert[:, 6:9] / mass)
        array = np.concatenate([own * mass / model.body_mass.sum(), data.cvel[:, :3]], axis=1).ravel()
    else:
        array = np.ravel(getattr(data, numbers.array))
    values = array[np.array(numbers.places, int)] + numbers.add
    if numbers.less:
        values = values - array[np.array(numbers.less, int)]
    return values if numbers.max_abs is None else np.clip(values, -numbers.max_abs, numbers.max_abs)


def ahead(simulation: Simulation, x: float, y: float) -> NDArray[np.float64]:
    sight = simulation.sight or 0.0
    found = np.tile([sight, sight, 0.0], (NUM_AHEAD, 1))
    coming = [one for one in simulation.obstacles if one[1] >= x]
    for row, (begin, end, middle) in zip(found, coming, strict=False):
        row[:] = min(begin - x, sight), min(end - x, sight), middle - y if begin - x < sight else 0.0
    return found.ravel()


def check(environment: MujocoEnv) -> None:
    """Observations and ends are those of the environment, after each step from each of its states."""
    simulation = environment.simulation()
    model = mujoco.MjModel.from_xml_string(simulation.model)
    data = mujoco.MjData(model)

    def seen(ends: Ends | None, action: Any) -> NDArray[np.float64]:
        parts = simulation.observation if ends is None else [ends.numbers]
        return np.concatenate([read(one, simulation, model, data, action) for one in parts])

    state = jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(0), NUM_ENVS))
    step = jax.jit(jax.vmap(environment.step))
    actions = jax.random.uniform(
        jax.random.key(1), (NUM_STEPS, NUM_ENVS, environment.action_size), minval=-1, maxval=1
    )
    for action in actions:
        after = step(state, action)
        for one in range(NUM_ENVS):
            mujoco.mj_resetData(model, data)
            for name in ("qpos", "qvel", "act", "qacc_warmstart"):
                getattr(data, name)[:] = getattr(state.physics, name)[one]
            data.ctrl[:] = simulation.control_offset + simulation.control_gain * np.asarray(action[one])
            mujoco.mj_step(model, data, simulation.num_substeps)
            for stage in (
                mujoco.mj_fwdPosition,
                mujoco.mj_sensorPos,
                mujoco.mj_fwdVelocity,
                mujoco.mj_sensorVel,
            ):
                stage(model, data)
            np.testing.assert_allclose(seen(None, action[one]), after.obs[one], rtol=1e-3, atol=1e-3)
            outside = [
                ((values := seen(ends, action[one])) < (-np.inf if ends.low is None else ends.low)).any()
                or (values > (np.inf if ends.high is None else ends.high)).any()
                for ends in simulation.ends
            ]
            assert any(outside) == bool(after.done[one])
        state = after


@pytest.mark.parametrize("body", [BODIES[0], *extra(*BODIES[1:])])
def test_a_simulation_gives_the_bodys_observation(body: str) -> None:
    check(of_the_catalog(body))


@pytest.mark.extra
def test_the_rats_simulation_is_without_its_skin() -> None:
    rodent = of_the_catalog("rodent")
    assert rodent.model.nskin == 1
    check(rodent)


CORRIDORS: list[dict[str, Any]] = [
    {"num_next_obstacles": 2, "observables": ["cvel", "qfrc_actuator"], "platform_length": [0.3, 0.6]},
    {"arena": "walls", "wall_gap": [3.6, 4.0], "num_next_obstacles": 4, "terminate_at_height": -0.1},
    {"walker": "rodent", "num_next_obstacles": 1, "aesthetic": "outdoor_natural"},
]


@pytest.mark.parametrize("options", [CORRIDORS[0], *extra(*CORRIDORS[1:])])
def test_a_corridors_simulation_says_what_is_ahead(options: dict[str, Any]) -> None:
    check(of_the_catalog("corridor", options))


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"num_layouts": 2}, "each episode has another corridor"),
        ({"egocentric_depth": 4}, "it sees by a camera"),
        ({"contact_termination": True}, "contacts end its episodes"),
        ({"walker": "humanoid", "arena": "empty"}, "added to the controls that hold its start"),
    ],
)
def test_a_corridor_that_takes_more_says_why_it_has_none(options: dict[str, Any], why: str) -> None:
    with pytest.raises(NotSimulated, match=why):
        of_the_catalog("corridor", options).simulation()


def test_options_change_what_a_simulation_says() -> None:
    options = {"exclude_current_positions_from_observation": False, "terminate_when_unhealthy": False}
    ant = of_the_catalog("ant", options)
    assert ant.simulation().ends == []
    check(ant)


def test_a_users_terms_are_said_in_mujocos_numbers(tmp_path: Path) -> None:
    options = {"observation": SEEN, "termination": ENDS}
    environment = of_a_user(tmp_path, **options, reset={"position_noise": 0.3})
    check(environment)
    # ±1 are the ends of the control's range, −1 and 3.
    simulation = environment.simulation()
    assert (list(simulation.control_offset), list(simulation.control_gain)) == ([1.0], [2.0])


def test_a_model_of_several_files_says_why_it_has_none(tmp_path: Path) -> None:
    text = CART.replace("<worldbody>", '<asset><mesh name="m" file="arm.stl"/></asset><worldbody>')
    spec = mujoco.MjSpec.from_string(text)
    with pytest.raises(NotSimulated, match=r"more than one file \(it has arm.stl\)"):
        as_xml(spec, mujoco.MjModel.from_xml_string(CART))


SERVOS = """
  <actuator>
    <position name="servo" joint="elbow" kp="3" kv="0.1" delay="0.03" nsample="4"/>
    <velocity name="speed" joint="elbow" kv="0.2"/>
    <cylinder name="piston" joint="elbow"/>
    <pid name="pid" class="pids" joint="elbow" ki="0.1"/>
    <dcmotor name="motor" joint="elbow" motorconst="1" resistance="1" controller="1 0 0" input="pos vel"/>
  </actuator>"""
SERVO_DEFAULTS = """<default>
    <position kp="5"/>
    <default class="pids"><pid kp="2" kv="0.1" input="pos vel"/></default>
  </default><worldbody>"""


def test_servos_are_written_for_the_older_mujoco_of_the_page_and_move_alike() -> None:
    """9.1: MuJoCo 3.17 writes `input` for servos, which 3.14 refuses for all but PID, DC motors and so3."""
    text = CART.replace("<worldbody>", SERVO_DEFAULTS).replace("<sensor>", SERVOS + "<sensor>")
    spec = mujoco.MjSpec.from_string(text)
    stepped = spec.compile()
    assert spec.to_xml().count("input=") >= 5
    written = as_xml(spec, stepped)
    assert re.findall(r'name="(\w+)"[^>]* input="([^"]*)"', written) == [
        ("pid", "pos vel"),
        ("motor", "pos vel"),
    ]
    models = [mujoco.MjModel.from_xml_string(one) for one in (spec.to_xml(), written)]
    differing = {
        name
        for name in dir(models[0])
        if isinstance(getattr(models[0], name), np.ndarray)
        and not np.array_equal(getattr(models[0], name), getattr(models[1], name))
    }
    # The kind of an input, such as a position, is a remark where there is one.
    assert differing == {"actuator_ctrlspec"}
    states = [mujoco.MjData(model) for model in models]
    for controls in np.random.default_rng(0).uniform(-1, 1, (500, models[0].nu)):
        for model, data in zip(models, states, strict=True):
            data.ctrl[:] = controls[: len(data.ctrl)]
            mujoco.mj_step(model, data)
    np.testing.assert_array_equal(states[0].qpos, states[1].qpos)
    np.testing.assert_array_equal(states[0].qvel, states[1].qvel)


@pytest.mark.parametrize(
    ("new", "why"),
    [
        (
            '<sensor><insidesite site="none" objtype="body" objname="arm" enclosed="true"/>',
            "attribute enclosed of insidesite, which is newer than MuJoCo 3.14",
        ),
        (
            '<extension><plugin plugin="mujoco.sensor.touch_grid"/></extension><sensor>',
            "plugin mujoco.sensor.touch_grid, which the page lacks",
        ),
    ],
)
def test_what_the_mujoco_of_the_page_lacks_is_named(new: str, why: str) -> None:
    spec = mujoco.MjSpec.from_string(CART.replace("<sensor>", new))
    with pytest.raises(NotSimulated, match=why):
        as_xml(spec, mujoco.MjModel.from_xml_string(CART))


def test_pictures_are_left_out_of_a_model() -> None:
    pictures = """
      <asset>
        <texture name="wood" type="2d" file="wood.png"/>
        <texture name="sky" type="skybox" fileup="up.png" filedown="down.png"/>
        <material name="wooden" texture="wood"/>
      </asset>
      <worldbody>"""
    text = CART.replace("<worldbody>", pictures).replace('mass="2"/>', 'mass="2" material="wooden"/>')
    stepped = mujoco.MjModel.from_xml_string(CART)
    model = mujoco.MjModel.from_xml_string(as_xml(mujoco.MjSpec.from_string(text), stepped))
    assert model.ntex == 0
    np.testing.assert_allclose(model.body_mass, stepped.body_mass)


def test_another_environment_says_why_it_has_none() -> None:
    with pytest.raises(NotSimulated, match="only the training has"):
        of_the_catalog("reacher").simulation()


def test_the_model_has_the_solver_that_the_engine_has() -> None:
    ant = of_the_catalog("ant", engine="mjx")
    model = mujoco.MjModel.from_xml_string(ant.simulation().model)
    assert (model.opt.iterations, model.opt.ls_iterations) == (1, 4)
    assert model.opt.disableflags == int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    np.testing.assert_allclose(model.body_mass, ant.model.body_mass, rtol=1e-5)
    np.testing.assert_allclose(model.body_inertia, ant.model.body_inertia, rtol=1e-5)
