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
from core.environments.simulated_model import NotSimulated, as_xml
from core.environments.simulation import Simulation
from core.environments.terrain.layouts import NUM_VARIANTS
from core.physics.choose import engine_builder
from core.physics.engine import DERIVED_FIELDS
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


class Stepped:
    """MuJoCo alone under a simulation, as docs/push.md describes it."""

    def __init__(self, simulation: Simulation, layout: int = 0) -> None:
        self.simulation = simulation
        self.model = mujoco.MjModel.from_xml_string(simulation.model)
        self.ground: Any = ()
        if (terrain := simulation.terrain) is not None:
            for name, rows in terrain.layouts[layout].model.items():
                field = getattr(self.model, name)
                field[terrain.geoms] = np.reshape(rows, field[terrain.geoms].shape)
            self.ground = terrain.layouts[layout].ground
        self.data = mujoco.MjData(self.model)
        self.carried: dict[str, Any] = {}

    def begin(self, physics: Any, command: Any = ()) -> NDArray[np.float64]:
        """The observation at the start, from these positions and velocities."""
        mujoco.mj_resetData(self.model, self.data)
        self.place(physics)
        mujoco.mj_forward(self.model, self.data)
        given = {**self._fields("after"), "command": command, "ground": self.ground}
        return self._after(self.simulation.begin(given))

    def place(self, physics: Any) -> None:
        for name in ("qpos", "qvel", "act", "qacc_warmstart"):
            getattr(self.data, name)[:] = getattr(physics, name)

    def step(self, action: Any, command: Any = ()) -> tuple[NDArray[np.float64], bool]:
        """The observation, and whether the episode ends."""
        carried = {f"state.{name}": value for name, value in self.carried.items()}
        told = {"action": action, "command": command, "ground": self.ground}
        given = {**self._fields("before"), **carried, **told}
        self.data.ctrl[:] = self.simulation.control(given)["control"]
        mujoco.mj_step(self.model, self.data, self.simulation.num_substeps)
        for stage in (
            mujoco.mj_fwdPosition,
            mujoco.mj_sensorPos,
            mujoco.mj_fwdVelocity,
            mujoco.mj_sensorVel,
        ):
            stage(self.model, self.data)
        outputs = self.simulation.step({**given, **self._fields("after")})
        return self._after(outputs), bool(outputs["ended"])

    def _fields(self, when: str) -> dict[str, Any]:
        names = ("qpos", "qvel", "act", "qacc_warmstart", "time", *DERIVED_FIELDS)
        return {f"{when}.{name}": np.copy(getattr(self.data, name)) for name in names}

    def _after(self, outputs: Mapping[str, Any]) -> NDArray[np.float64]:
        self.carried = {
            name.removeprefix("state."): value for name, value in outputs.items() if name.startswith("state.")
        }
        return outputs["observation"]


def check(environment: MujocoEnv, command: Any = ()) -> None:
    """Observations and ends are those of the environment, after each step from each of its states."""
    simulation = environment.simulation()
    assert len(simulation.command) == len(command)
    if len(command):
        environment = environment.told(jax.numpy.array(command))
    state = jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(0), NUM_ENVS))
    step = jax.jit(jax.vmap(environment.step))
    actions = jax.random.uniform(
        jax.random.key(1), (NUM_STEPS, NUM_ENVS, environment.action_size), minval=-1, maxval=1
    )
    layouts = np.zeros(NUM_ENVS, int)
    if simulation.terrain is not None:
        layouts = np.asarray(state.info["terrain"]) // NUM_VARIANTS
    bodies = [Stepped(simulation, int(layout)) for layout in layouts]
    for one, body in enumerate(bodies):
        seen = body.begin(jax.tree.map(lambda values, one=one: values[one], state.physics), command)
        np.testing.assert_allclose(seen, state.obs[one], rtol=1e-3, atol=1e-3)
    for action in actions:
        after = step(state, action)
        for one, body in enumerate(bodies):
            body.place(jax.tree.map(lambda values, one=one: values[one], state.physics))
            mujoco.mj_forward(body.model, body.data)
            seen, has_ended = body.step(np.asarray(action[one]), command)
            np.testing.assert_allclose(seen, after.obs[one], rtol=1e-3, atol=1e-3)
            assert has_ended == bool(after.done[one])
        state = after


@pytest.mark.parametrize("body", [BODIES[0], *extra(*BODIES[1:])])
def test_a_simulation_gives_the_bodys_observation(body: str) -> None:
    check(of_the_catalog(body))


@pytest.mark.extra
@pytest.mark.parametrize("robot", ["g1", "go1"])
def test_a_robots_simulation_is_told_what_to_do(robot: str) -> None:
    check(of_the_catalog(robot), [0.5, -0.2, 0.7])


# Of these kinds all variants are alike, and a simulation has the first.
STEPS: dict[str, Any] = {
    "terrain": {"kinds": ["stairs_down", "slope_up", "pits"], "levels": [3, 5]},
    "observation": [{"kind": "height_scan"}, {"kind": "foot_height"}, {"kind": "base_linear_velocity"}],
}


@pytest.mark.extra
def test_a_robots_simulation_has_the_ground_that_it_walks_on() -> None:
    go1 = of_the_catalog("go1", STEPS)
    check(go1, [0.5, -0.2, 0.7])


@pytest.mark.extra
def test_the_rats_simulation_is_without_its_skin() -> None:
    rodent = of_the_catalog("rodent")
    assert rodent.model.nskin == 1
    check(rodent)


CORRIDORS: list[dict[str, Any]] = [
    {"num_next_obstacles": 2, "observables": ["cvel", "qfrc_actuator"], "platform_length": [0.3, 0.6]},
    {"arena": "walls", "wall_gap": [3.6, 4.0], "num_next_obstacles": 4, "terminate_at_height": -0.1},
    {"walker": "rodent", "num_next_obstacles": 1, "aesthetic": "outdoor_natural"},
    {"egocentric_depth": 4, "contact_termination": True},
    {"walker": "humanoid", "arena": "empty"},
]


@pytest.mark.parametrize("options", [CORRIDORS[0], *extra(*CORRIDORS[1:])])
def test_a_corridors_simulation_says_what_is_ahead(options: dict[str, Any]) -> None:
    check(of_the_catalog("corridor", options))


@pytest.mark.extra
def test_a_corridor_that_differs_from_episode_to_episode_says_why_it_has_none() -> None:
    with pytest.raises(NotSimulated, match="each episode has another corridor"):
        of_the_catalog("corridor", {"num_layouts": 2}).simulation()


def test_options_change_what_a_simulation_says() -> None:
    options = {"exclude_current_positions_from_observation": False, "terminate_when_unhealthy": False}
    ant = of_the_catalog("ant", options)
    assert not ant.simulation().step.only(["ended"]).inputs
    check(ant)


WALKS = {
    "command": {"kind": "velocity"},
    "feet": ["arm"],
    "gait": {"offsets": [0.0]},
    "events": [{"kind": "push", "every_s": 0.1}],
    "reward": [{"kind": "track_linear_velocity"}],
    "termination": [{"kind": "bad_orientation", "limit_angle": 0.5}],
    "observation": [
        {"kind": "base_linear_velocity", "noise": 0.2, "scale": 2.0, "history": 3},
        {"kind": "projected_gravity", "delay": [0.02, 0.04]},
        {"kind": "joint_positions", "clip": 0.1},
        {"kind": "command"},
        {"kind": "gait_phase"},
        {"kind": "previous_action"},
    ],
}


def test_what_terms_compute_and_remember_is_told_without_chance(tmp_path: Path) -> None:
    environment = of_a_user(tmp_path, **WALKS)
    simulation = environment.simulation()
    assert [(one.name, one.low, one.high) for one in simulation.command][2] == ("turn", -1.0, 1.0)
    carried = {name for name, _ in simulation.step.document()["inputs"] if name.startswith("state.")}
    assert "state.phase" in carried
    assert not carried & {"state.key", "state.command"}


def test_a_users_terms_are_said_in_mujocos_numbers(tmp_path: Path) -> None:
    options = {"observation": SEEN, "termination": ENDS}
    environment = of_a_user(tmp_path, **options, reset={"position_noise": 0.3})
    check(environment)
    # ±1 are the ends of the control's range, −1 and 3.
    controls = [environment.simulation().control({"action": [end]})["control"] for end in (-1, 1)]
    np.testing.assert_allclose(controls, [[-1.0], [3.0]])


MESHES = """<asset><mesh name="m" file="{file}"/></asset><worldbody>
  <geom name="shape" type="mesh" mesh="m" contype="{contacts}" conaffinity="{contacts}"/>"""


def test_a_mesh_that_touches_others_is_why_there_is_none() -> None:
    text = CART.replace("<worldbody>", MESHES.format(file="arm.stl", contacts=1))
    spec = mujoco.MjSpec.from_string(text)
    with pytest.raises(NotSimulated, match=r"touches others is the mesh arm.stl"):
        as_xml(spec, mujoco.MjModel.from_xml_string(CART))


def test_meshes_that_are_looks_are_left_out_and_keep_their_weight(tmp_path: Path) -> None:
    corners = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 .5\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (tmp_path / "arm.obj").write_text(corners)
    shapes = """<geom name="look" type="mesh" mesh="m" contype="0" conaffinity="0" pos=".1 0 0"/>
      <geom name="fitted" type="capsule" mesh="m" contype="0" conaffinity="0"/><joint name="elbow" """
    asset = '<asset><mesh name="m" file="arm.obj"/></asset><worldbody>'
    text = CART.replace("<worldbody>", asset).replace('<joint name="elbow" ', shapes)
    file = tmp_path / "body.xml"
    file.write_text(text)
    spec = mujoco.MjSpec.from_file(str(file))
    stepped = spec.compile()
    (tmp_path / "arm.obj").unlink()
    model = mujoco.MjModel.from_xml_string(as_xml(spec, stepped))
    assert (stepped.nmesh, model.nmesh, model.ngeom) == (1, 0, stepped.ngeom - 1)
    for name in ("body_mass", "body_inertia", "body_ipos"):
        np.testing.assert_allclose(getattr(model, name), getattr(stepped, name), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(model.geom("fitted").size, stepped.geom("fitted").size, rtol=1e-5)


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
    with pytest.raises(NotSimulated, match="made for each training"):
        of_the_catalog("reacher").simulation()


def test_the_model_has_the_solver_that_the_engine_has() -> None:
    ant = of_the_catalog("ant", engine="mjx")
    model = mujoco.MjModel.from_xml_string(ant.simulation().model)
    assert (model.opt.iterations, model.opt.ls_iterations) == (1, 4)
    assert model.opt.disableflags == int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    np.testing.assert_allclose(model.body_mass, ant.model.body_mass, rtol=1e-5)
    np.testing.assert_allclose(model.body_inertia, ant.model.body_inertia, rtol=1e-5)
