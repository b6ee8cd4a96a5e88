"""What the catalog says of an observation's and an action's numbers is true of the real environment."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from core.environments import catalog
from core.environments.cpg import roles
from core.environments.cpg.options import CPGOptions, GaitOptions
from core.environments.cpg.roles import decode
from core.environments.describe_bodies import pages
from core.environments.environment import Environment, State
from core.environments.info import EnvironmentInfo, Slice, Spaces, in_order, named
from core.environments.mjcf.info import MjcfOptions
from core.environments.terms.array_slices import CINERT, CVEL
from core.environments.terms.describe import inventory
from core.environments.terms.inventory import TABLE
from core.environments.terms.task import task_slices
from core.physics.choose import engine_builder
from tests.unit.environments.mjcf import probe

ALL = {"exclude_current_positions_from_observation": False}
CASES: list[tuple[str, dict[str, Any]]] = [
    ("ant", {}),
    ("reacher", {}),
    ("rodent", {}),
    ("corridor", {"num_next_obstacles": 2, "observables": ["cinert", "cvel", "qfrc_actuator"]}),
    ("brittle_star", {"num_segments_per_arm": 2}),
    ("brittle_star", {"num_segments_per_arm": 1, "control": "cpg", "num_arms": 4}),
    (
        "brittle_star_undirected",
        {"num_segments_per_arm": [2, 0, 3], "num_arms": 3, "actuation": "torque_control"},
    ),
]
# The same bodies under other options, and bodies like these.
MORE_CASES: list[tuple[str, dict[str, Any]]] = [
    ("ant", ALL),
    *(("half_cheetah", options) for options in ({}, ALL)),
    *(("hopper", options) for options in ({}, ALL)),
    *(("walker2d", options) for options in ({}, ALL)),
    *(("humanoid", options) for options in ({}, ALL)),
    ("inverted_pendulum", {}),
    ("rodent", {"exclude_current_positions_from_observation": True}),
    ("corridor", {"walker": "rodent", "arena": "empty", **ALL}),
    ("corridor", {"walker": "humanoid", "arena": "walls", "num_next_obstacles": 1, "egocentric_depth": 2}),
    ("corridor", {"walker": "jumping_ball", "arena": "empty", "observables": ["cvel"], **ALL}),
    (
        "brittle_star",
        {"num_segments_per_arm": 1, "observables": ["segment_contact", "xy_distance_to_target"]},
    ),
    ("brittle_star_light_escape", {"num_segments_per_arm": 2}),
]


@dataclass
class Recorded:
    """An engine that keeps the controls it was given."""

    engine: Any
    controls: list[NDArray[np.float32]] = field(default_factory=list)

    def step(self, state: Any, control: jax.Array) -> Any:
        if not isinstance(control, jax.core.Tracer):
            self.controls.append(np.asarray(control))
        return self.engine.step(state, control)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.engine, name)


@dataclass(frozen=True)
class Case:
    info: EnvironmentInfo
    environment: Environment
    recorded: Recorded

    @property
    def spaces(self) -> Spaces:
        return self.info.spaces

    @cached_property
    def state(self) -> State:
        """After a random action; nothing is compiled."""
        state, shape = self.environment.reset(jax.random.key(3)), (self.environment.action_size,)
        return self.environment.step(state, jax.random.uniform(jax.random.key(0), shape, minval=-1.0))


@pytest.fixture(
    scope="module",
    params=[*CASES, *(pytest.param(case, marks=pytest.mark.slow) for case in MORE_CASES)],
    ids=lambda case: f"{case[0]}-{'-'.join(map(str, case[1]))}",
)
def case(request: pytest.FixtureRequest) -> Case:
    environment_id, given = request.param
    info, options = catalog.resolve(environment_id, given)
    kept: list[Recorded] = []

    def build(*arguments: Any, **settings: Any) -> Any:
        kept.append(Recorded(engine_builder("native")(*arguments, **settings)))
        return kept[0]

    return Case(info, catalog.make(info, options, build), kept[0])


# By slice: where MuJoCo keeps a number of this name. `qvel` stands for every array of degrees of freedom.
_OF_A_JOINT = {"joint_position": "qpos", "joint_velocity": "qvel"}
_FORCES = ("qfrc_actuator", "joint_actuator_force", "actuator_force")
_PLACES = {
    "qpos": {"x": 0, "y": 1, "z": 2, "qw": 3, "qx": 4, "qy": 5, "qz": 6},
    "qvel": {"vx": 0, "vy": 1, "vz": 2, "wx": 3, "wy": 4, "wz": 5},
    "qfrc_actuator": {"fx": 0, "fy": 1, "fz": 2, "tx": 3, "ty": 4, "tz": 5},
}


def found_by_name(model: mujoco.MjModel, state: State, array: str, component: str) -> float:
    """The number in the physics, found by the name of its joint or its body alone."""
    if array in ("cinert", "cvel"):
        body, part = component.split(" ")
        column = (CINERT if array == "cinert" else CVEL).index(part)
        return float(state.physics.derived[array][model.body(body).id, column])
    joints = {model.joint(number).name: model.joint(number) for number in range(model.njnt)}
    array = "qfrc_actuator" if array in _FORCES else _OF_A_JOINT.get(array, array)
    joint, _, part = (component, "", "") if component in joints else component.rpartition(" ")
    start = joints[joint].qposadr[0] if array == "qpos" else joints[joint].dofadr[0]
    values = state.physics.derived[array] if array == "qfrc_actuator" else getattr(state.physics, array)
    return float(values[int(start) + _PLACES[array].get(part, 0)])


def test_the_slices_are_the_whole_observation_and_action_without_gaps(case: Case) -> None:
    for slices, size in (
        (case.spaces.observation, case.environment.observation_size),
        (case.spaces.action, case.environment.action_size),
    ):
        assert [one.start for one in slices] == [sum(x.size for x in slices[:i]) for i in range(len(slices))]
        assert sum(one.size for one in slices) == size
        assert all(len(one.components) == one.size > 0 for one in slices)
    assert case.info.observation_size == case.environment.observation_size


def test_each_number_is_that_of_the_part_it_names(case: Case) -> None:
    state, model = case.state, case.environment.model
    arrays = ("qpos", "qvel", "height", "cinert", "cvel", *_FORCES, *_OF_A_JOINT)
    checked = 0
    for one in case.spaces.observation:
        if one.name not in arrays:
            continue
        seen = np.asarray(state.obs[one.start : one.start + one.size])
        bound = one.high if one.name == "qvel" else None
        for value, component in zip(seen, one.components, strict=True):
            if component == "torso height":
                expected = float(state.physics.qpos[1]) + float(model.body("torso").pos[2])
            else:
                expected = found_by_name(model, state, one.name, component)
            assert value == pytest.approx(
                np.clip(expected, *(-bound, bound)) if bound else expected, rel=1e-6
            )
            checked += 1
    # The reacher's are made of angles; the one star was asked for contacts and a distance alone.
    assert checked or case.info.id in ("reacher", "brittle_star")


def test_a_quantitys_unit_is_that_of_its_joints(case: Case) -> None:
    model = case.environment.model
    kinds = {model.joint(number).name: int(model.joint(number).type[0]) for number in range(model.njnt)}
    units = {"qpos": ("m", "rad"), "qvel": ("m/s", "rad/s"), "qfrc_actuator": ("N", "N m")}
    for one in case.spaces.observation:
        for component in one.components if one.name in units else ():
            if component in kinds:
                along, about = units[one.name]
                assert one.unit == (along if kinds[component] == mujoco.mjtJoint.mjJNT_SLIDE else about)


def test_the_ends_of_an_action_set_what_they_say_at_the_actuator_that_they_name(case: Case) -> None:
    environment, model, state = case.environment, case.environment.model, case.state
    if case.info.option_values.model_dump().get("control") == "cpg":
        pytest.skip("its actions set oscillators")
    assert [one.name for one in case.spaces.action] == [name_of(model, number) for number in range(model.nu)]
    for end in (-1.0, 1.0):
        case.recorded.controls.clear()
        environment.step(state, jnp.full(environment.action_size, end))
        [control] = case.recorded.controls
        said = [one.low if end < 0 else one.high for one in case.spaces.action]
        np.testing.assert_allclose(control, np.array(said, float), rtol=1e-6)
        np.testing.assert_allclose(control, model.actuator_ctrlrange[:, int(end > 0)], rtol=1e-6)


def name_of(model: mujoco.MjModel, actuator: int) -> str:
    """Its own name, or that of the joint that it moves."""
    return model.actuator(actuator).name or model.joint(int(model.actuator_trnid[actuator, 0])).name


def test_the_obstacles_ahead_are_named_in_their_order() -> None:
    info, options = catalog.resolve("corridor", {"num_next_obstacles": 2, "platform_length": [1.5, 1.5]})
    state = catalog.make(info, options, engine_builder("native")).reset(jax.random.key(0))
    ahead = {
        (one.name, one.components[0]): float(state.obs[one.start]) for one in info.spaces.observation[-6:]
    }
    # It stands at 5 m, give or take its noise; the first gap begins after two platforms, 6 m and 1.5 m long.
    x = float(state.physics.qpos[0])
    assert ahead["obstacle_1", "begins ahead"] == pytest.approx(7.5 - x, abs=1e-4)
    assert 0.05 < ahead["obstacle_1", "ends ahead"] - ahead["obstacle_1", "begins ahead"] < 0.2
    assert ahead["obstacle_2", "begins ahead"] == pytest.approx(
        ahead["obstacle_1", "ends ahead"] + 1.5, abs=1e-4
    )
    assert [one.high for one in info.spaces.observation[-6:]] == [10.0, 10.0, None] * 2


def test_the_ends_of_a_generators_action_mean_what_they_say() -> None:
    cpg = CPGOptions(
        max_amplitude=0.5,
        max_offset=0.4,
        max_frequency_hz=1.5,
        gait=GaitOptions(sweep=0.5, stroke=0.5, lift=0.4),
    )
    info, _ = catalog.resolve("brittle_star", {"control": "cpg", "num_arms": 3, "cpg": cpg.model_dump()})
    by_name = {one.name: one for one in info.spaces.action}
    low, high = (decode(jnp.full(22, end), cpg) for end in (-1.0, 1.0))
    for name, read in _DECODED.items():
        bounds = [float(np.asarray(read(end)).ravel()[0]) for end in (low, high)]
        assert bounds == pytest.approx([by_name[name].low, by_name[name].high]), name
        assert by_name[name].size == np.asarray(read(low)).size
    # Arm 1 to arm 2 in the plane: the oscillators 2 and 4.
    place = by_name["phase_bias"].components.index("arm 1 to arm 2 in plane")
    assert roles.edges(3)[place].tolist() == [2, 4]
    assert by_name["amplitude"].components[:2] == ("arm 0 in plane", "arm 0 out of plane")


_DECODED: dict[str, Callable[[Any], Any]] = {
    "amplitude": lambda modulation: modulation.amplitudes,
    "offset": lambda modulation: modulation.offsets,
    "phase_bias": lambda modulation: roles.along_edges(modulation.phase_biases),
    "frequency": lambda modulation: modulation.frequencies[:1],
}


def test_a_stars_contacts_and_light_come_segment_by_segment() -> None:
    info, options = catalog.resolve("brittle_star_light_escape", {"num_segments_per_arm": [2, 0, 1, 1, 1]})
    model = catalog.make(info, options, engine_builder("native")).model
    by_name = {one.name: one for one in info.spaces.observation}
    sensors = [model.sensor(number).name for number in range(model.nsensor)]
    capsules = [name for n in range(model.ngeom) if (name := model.geom(n).name).endswith("_capsule")]
    for slice_name, parts in (("segment_contact", sensors), ("segment_light_intake", capsules)):
        for segment, part in zip(by_name[slice_name].components, parts, strict=True):
            assert f"/{segment}_" in part


def test_terms_on_a_users_model_have_their_slices() -> None:
    model = mujoco.MjModel.from_xml_string(probe.XML.decode())
    kinds = ("qpos", "qvel", "previous_action", "body_positions", "cvel", "qfrc_actuator", "sensors")
    given = probe.options(observation=[{"kind": kind} for kind in kinds])
    spaces = task_slices(MjcfOptions.model_validate(given), inventory(model))
    assert spaces.observation == in_order(
        [
            named("qpos", ["root z"], "m"),
            named("qpos", [f"root q{axis}" for axis in "wxyz"], "1"),
            named("qpos", ["elbow"], "rad"),
            named("qvel", [f"root v{axis}" for axis in "xyz"], "m/s"),
            named("qvel", [*(f"root w{axis}" for axis in "xyz"), "elbow"], "rad/s"),
            named("previous_action", ["elbow"], "1", -1.0, 1.0),
            named("body_positions", [f"{body} {axis}" for body in ("ball", "arm") for axis in "xyz"], "m"),
            named("cvel", [f"{body} {part}" for body in ("ball", "arm") for part in CVEL], "rad/s, m/s"),
            named("qfrc_actuator", [f"root f{axis}" for axis in "xyz"], "N"),
            named("qfrc_actuator", [*(f"root t{axis}" for axis in "xyz"), "elbow"], "N m"),
            named("sensors", [f"speed {number}" for number in range(3)], "m/s"),
            named("sensors", ["angle"], None),
        ]
    )
    assert spaces.action == (Slice("elbow", 0, 1, None, -0.5, 1.5, ("elbow",)),)


@pytest.mark.parametrize("id", ["playground/CheetahRun", "brax/ant"])
def test_another_packages_numbers_are_one_slice_without_names(id: str) -> None:
    info = catalog.find(id)
    assert info.spaces.observation == (Slice("observation", 0, info.observation_size or 0),)
    assert info.spaces.action == (Slice("action", 0, info.action_size or 0),)


def test_the_table_of_bodies_is_that_of_the_models() -> None:
    known = json.loads(TABLE.read_text()).items()
    assert pages() == {name: row for name, row in known if "/" not in name}
