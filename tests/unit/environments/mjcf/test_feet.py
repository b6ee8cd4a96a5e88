"""Terms of feet and contacts, on the probe's ball: each number can be worked out by hand."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from pydantic import TypeAdapter

from core.environments import catalog
from core.environments.environment import Environment
from core.environments.mjcf.check import problems
from core.environments.terms.describe import inventory
from core.environments.terms.feet import feet_of
from core.environments.terms.memory import FootTimes
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.term import Term
from core.environments.terms.terminations import AnyTermination
from core.environments.terms.vocabulary import AnyReward
from core.errors import Rejected
from core.physics.availability import EngineName, check_physics, choose
from tests.unit.environments.mjcf.probe import KEY, XML, build
from tests.unit.environments.mjcf.test_check import PROBE, parsed
from tests.unit.environments.mjcf.test_environment import NO_TORQUE, moving

MODEL = mujoco.MjModel.from_xml_string(XML.decode())
UP = [0, 0, 0.5, 1, 0, 0, 0, 0.0]
STILL = [0.0] * 7


def measured(term: dict[str, Any], **where: Any) -> float:
    """A term's value after a step of 0.02 s to these positions and velocities. The rest is of `Step`."""
    physics = [state(UP, STILL), state(where.pop("qpos", UP), where.pop("qvel", STILL))]
    feet = feet_of(MODEL, ["ball"], np.array(UP, float))
    index = ModelIndex(MODEL, 1, np.array(UP, float), feet, num_actions=MODEL.nu)
    known = {"command": np.array([0.5, 0, 0]), "start": np.zeros(3), "phases": np.zeros(1), **where}
    step = Step(*physics, np.zeros(1), np.zeros(1), 0.02, np, **known)
    made: Term = TypeAdapter[Any](AnyTermination if term.pop("ends", False) else AnyReward).validate_python(
        term
    )
    return float(made.measure(step, index))


def state(qpos: list[float], qvel: list[float]) -> SimpleNamespace:
    data = mujoco.MjData(MODEL)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(MODEL, data)
    derived = {name: getattr(data, name) for name in ("xpos", "xmat", "cinert", "cvel", "qfrc_actuator")}
    return SimpleNamespace(qpos=data.qpos, qvel=data.qvel, derived=derived)


def times(landed: int, air_time: float, peak: float = 0.0) -> FootTimes:
    return FootTimes(*(np.array([float(x)]) for x in (landed, landed, air_time, 0.0, peak)))


# By 1 rad about x.
LEANS = [0, 0, 1, np.cos(0.5), np.sin(0.5), 0, 0, 0]
STANDS = {"command": np.zeros(3)}


@pytest.mark.parametrize(
    ("term", "where", "expected"),
    [
        ({"kind": "air_time"}, {"foot_times": times(1, 0.3)}, 0.2),
        ({"kind": "air_time", "most": 0.25}, {"foot_times": times(1, 0.3)}, 0.15),
        ({"kind": "air_time"}, {"foot_times": times(0, 0.3)}, 0.0),
        ({"kind": "air_time"}, {"foot_times": times(1, 0.3), **STANDS}, 0.0),
        ({"kind": "air_time"}, {"foot_times": times(1, 0.04), "command": None}, -0.06),
        ({"kind": "foot_swing_height", "height": 0.2}, {"foot_times": times(1, 0.3, 0.3)}, 0.25),
        ({"kind": "foot_swing_height", "height": 0.2}, {"foot_times": times(0, 0.3, 0.3)}, 0.0),
        # 0.02 m in 0.02 s, and the sole is 0.4 m up: 0.3 m above the wanted height, times 1 m/s.
        ({"kind": "foot_clearance"}, {"qpos": [0.02, 0, 0.5, 1, 0, 0, 0, 0]}, 0.3),
        ({"kind": "foot_clearance"}, {"qpos": [0.02, 0, 0.5, 1, 0, 0, 0, 0], **STANDS}, 0.0),
        ({"kind": "variable_posture"}, {"qpos": [*UP[:7], 0.3]}, np.exp(-1)),
        ({"kind": "variable_posture"}, {"qpos": [*UP[:7], 0.05], **STANDS}, np.exp(-1)),
        # ‖(1.2, 0.5)‖ + 0.3 = 1.6.
        (
            {"kind": "variable_posture"},
            {"qpos": [*UP[:7], 1.0], "command": np.array([1.2, 0.5, -0.3])},
            np.exp(-4),
        ),
        ({"kind": "base_height"}, {"qpos": [0, 0, 0.7, 1, 0, 0, 0, 0]}, 0.04),
        ({"kind": "base_height", "height": 0.1}, {}, 0.16),
        ({"kind": "action_acceleration"}, {"earlier_action": np.array([0.5])}, 0.25),
        ({"kind": "out_of_bounds", "distance": 4.9, "ends": True}, {"start": np.array([3.0, 4, 9])}, 1.0),
        ({"kind": "out_of_bounds", "distance": 5.1, "ends": True}, {"start": np.array([3.0, 4, 9])}, 0.0),
        ({"kind": "bad_orientation", "limit_angle": 0.9, "ends": True}, {"qpos": LEANS}, 1.0),
        ({"kind": "bad_orientation", "limit_angle": 1.1, "ends": True}, {"qpos": LEANS}, 0.0),
    ],
)  # fmt: skip
def test_a_term_is_worth_what_its_formula_says(
    term: dict[str, Any], where: dict[str, Any], expected: float
) -> None:
    assert measured(dict(term), **where) == pytest.approx(expected, abs=1e-6)


def test_angular_momentum_is_that_of_mujoco() -> None:
    qpos, qvel = [0.3, 0.2, 0.5, 0.8, 0.6, 0, 0, 0.4], [1.0, -2, 0.5, 3, 1, -2, 4]
    data = mujoco.MjData(MODEL)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(MODEL, data)
    mujoco.mj_subtreeVel(MODEL, data)
    momentum = data.subtree_angmom[1]
    assert measured({"kind": "angular_momentum"}, qpos=qpos, qvel=qvel) == pytest.approx(momentum @ momentum)


# Heights of the ball's centre after each step of 0.01 s. At 0.09 m it touches the floor.
HEIGHTS = (0.09, 0.3, 0.4, 0.3, 0.09, 0.3)


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, float]]:
    """Observations, then the terms of the reward, after each of these steps."""
    seen = ["foot_contact", "foot_air_time", "foot_height", "foot_contact_force"]
    reward: list[dict[str, Any]] = [
        {"kind": "air_time", "least": 0.01, "most": 0.035},
        {"kind": "foot_swing_height", "height": 0.2},
        {"kind": "soft_landing"},
        {"kind": "undesired_contacts", "bodies": ["b.*"]},
        {"kind": "foot_slip", "height": None},
        {"kind": "electrical_power"},
    ]
    environment: Environment = build(
        tmp_path_factory.mktemp("swing"),
        feet=["ball"],
        observation=[{"kind": kind} for kind in seen],
        reward=reward,
        termination=[],
    )
    step, state = jax.jit(environment.step), environment.reset(KEY)
    rows = list[dict[str, float]]()
    for height in HEIGHTS:
        state = step(moving(state, qpos=[0, 0, height, 1, 0, 0, 0, 0], qvel=[0.0] * 7), NO_TORQUE)
        parts = {term["kind"]: float(state.metrics[f"reward_{term['kind']}"]) for term in reward}
        rows.append({**dict(zip(seen, map(float, state.obs), strict=True)), **parts})
    return rows


def test_a_swing_is_timed_from_contact_to_contact(swing: list[dict[str, float]]) -> None:
    def of(name: str) -> list[float]:
        return [row[name] for row in swing]

    assert of("foot_contact") == [1, 0, 0, 0, 1, 0]
    assert of("foot_air_time") == pytest.approx([0, 0.01, 0.02, 0.03, 0, 0.01])
    assert of("foot_height") == pytest.approx([-0.01, 0.2, 0.3, 0.2, -0.01, 0.2], abs=3e-3)
    # It begins in the air: what comes down first has no swing behind it. The other swing took 0.04 s.
    assert of("air_time") == pytest.approx([0, 0, 0, 0, 0.025, 0])
    assert of("foot_swing_height") == pytest.approx([0, 0, 0, 0, -0.25, 0], abs=1e-4)
    assert of("undesired_contacts") == [-1, 0, 0, 0, -1, 0]
    forces = of("foot_contact_force")
    assert [force > 1 for force in forces] == [True, False, False, False, True, False]
    assert of("soft_landing") == [0, 0, 0, 0, -forces[4], 0]


def stumbles(folder: Path, engine: EngineName, degrees: float) -> list[list[float]]:
    """How `stumble` counts with ratios of 3.5 and 5, above a slope and on it.

    Without friction, the force is along the slope's normal.
    """
    floor = '<geom name="floor" type="plane" size="5 5 1"/>'
    slope = floor.replace("/>", f' euler="0 {degrees} 0" condim="1"/>')
    xml = XML.decode().replace(floor, slope).replace('size="0.1" mass', 'size="0.1" condim="1" mass')
    reward = [{"kind": "stumble", "ratio": ratio, "name": f"r{ratio:.0f}"} for ratio in (3.5, 5.0)]
    environment = build(folder, xml.encode(), engine, feet=["ball"], reward=reward, termination=[])
    normal = np.array([np.sin(np.deg2rad(degrees)), 0, np.cos(np.deg2rad(degrees))])
    step, state, found = jax.jit(environment.step), environment.reset(KEY), list[list[float]]()
    for distance in (0.2, 0.09):
        state = step(moving(state, qpos=[*distance * normal, 1, 0, 0, 0, 0], qvel=[0.0] * 7), NO_TORQUE)
        found.append([-float(state.metrics[f"reward_r{name}"]) for name in (4, 5)])
    return found


@pytest.mark.parametrize(("degrees", "on_it"), [(0, [0, 0]), (75, [1, 0]), (80, [1, 1])])
def test_a_foot_stumbles_against_what_is_steep(degrees: float, on_it: list[float], tmp_path: Path) -> None:
    # The tangents, horizontal to vertical: 3.73 at 75° and 5.67 at 80°.
    assert stumbles(tmp_path, "native", degrees) == [[0, 0], on_it]


def test_an_engine_that_cannot_tell_the_direction_of_forces_is_refused_and_auto_takes_another() -> None:
    row, _ = catalog.resolve("go1", {"reward": [{"kind": "stumble"}, {"kind": "track_linear_velocity"}]})
    for engine in ("compiled", "mjx"):
        with pytest.raises(Rejected, match=r"the term `stumble` reads .* which native and warp alone tell"):
            check_physics(engine, row.cannot_run)
    taken = [choose("auto", device, 4096, row.rules_on(device), row.cannot_run) for device in ("cpu", "gpu")]
    assert [choice.name for choice in taken] == ["native", "warp"]
    assert not catalog.resolve("go1", {})[0].cannot_run


@pytest.mark.parametrize(
    ("given", "pointer", "sentence"),
    [
        (
            {"feet": ["arm"], "observation": [{"kind": "foot_contact"}]},
            "/observation/0",
            "needs feet that can touch something, and no geom of 'arm' can",
        ),
        ({"reward": [{"kind": "soft_landing"}]}, "/reward/0", "soft_landing needs `feet`"),
        (
            {"termination": [{"kind": "illegal_contact", "bodies": ["ball", "arm"]}]},
            "/termination/0/bodies/1",
            "no body with a geom that can touch anything that 'arm' matches",
        ),
        (
            {
                "command": {"kind": "velocity"},
                "reward": [{"kind": "variable_posture", "running": {"knee": 1}}],
            },
            "/reward/0/running",
            "no hinge or slide that 'knee' matches",
        ),
    ],
)
def test_contacts_that_cannot_be_are_refused_with_their_place(
    given: dict[str, Any], pointer: str, sentence: str
) -> None:
    (problem,) = problems(parsed(**given), PROBE)
    assert problem.pointer == f"/environment/options{pointer}"
    assert sentence in problem.detail


def test_a_foot_that_slips_by_height_needs_no_contacts(tmp_path: Path) -> None:
    by_height = parsed(feet=["arm"], reward=[{"kind": "foot_slip"}])
    assert problems(by_height, PROBE) == by_height.readings(PROBE) == []
    by_contact = parsed(feet=["ball"], reward=[{"kind": "foot_slip", "height": None}])
    assert [reading.sensor for reading in by_contact.readings(inventory(MODEL))] == ["gaitway:touches:sphere"]
