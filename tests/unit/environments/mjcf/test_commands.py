"""Commands: what is drawn, what is told of it in each step, and what following it is worth."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from core.environments.mjcf.check import problems
from core.environments.terms.commands import AnyCommand, PositionCommand, VelocityCommand
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.vocabulary import AnyReward
from tests.unit.environments.mjcf.probe import KEY, build
from tests.unit.environments.mjcf.test_check import PROBE, parsed
from tests.unit.environments.mjcf.test_environment import NO_TORQUE, moving
from tests.unit.environments.mjcf.test_feet import MODEL, STILL, UP, state

INDEX = ModelIndex(MODEL, 1, np.array(UP), [])
# The ball's x points to the world's y, and it is at (1, 2).
LEFT = [1, 2, 0.5, np.sqrt(0.5), 0, 0, np.sqrt(0.5), 0]


def at(qpos: list[float], **known: Any) -> Step:
    physics = state(qpos, STILL)
    return Step(physics, physics, np.zeros(1), np.zeros(1), 0.02, np, **known)


def command(**given: Any) -> Any:
    return TypeAdapter[Any](AnyCommand).validate_python(given)


def test_a_heading_is_turned_to_within_the_range_of_turns() -> None:
    told = command(kind="velocity", heading=[-3, 3], turn=[-1, 1], heading_share=0.5, standing=0.2)
    assert isinstance(told, VelocityCommand)
    assert told.num_random == 6
    uniform = np.array([1.0, 0.5, 0.75, 0.5, 0.5, 0.4])
    by_heading = told.drawn(uniform, at(UP), INDEX)
    assert by_heading.tolist() == [1.0, 0.0, 0.5, 0.0, 1.0]
    # It faces π/2 and is to face 0; then by 0.1 rad less than a half turn, on the shorter way.
    assert told.told(by_heading, at(LEFT), INDEX).tolist() == pytest.approx([1.0, 0.0, -np.pi / 4])
    target = np.array([1.0, 0, 0.5, np.pi / 2 + np.pi + 0.1, 1])
    assert told.told(target, at(LEFT), INDEX)[2] == -1.0
    target[3] = np.pi / 2 + 0.3
    assert told.told(target, at(LEFT), INDEX)[2] == pytest.approx(0.15)
    by_turn = told.drawn(np.array([1.0, 0.5, 0.75, 0.5, 0.5, 0.6]), at(UP), INDEX)
    assert told.told(by_turn, at(LEFT), INDEX).tolist() == [1.0, 0.0, 0.5]
    stands = told.drawn(np.array([1.0, 0.5, 0.75, 0.1, 0.5, 0.4]), at(UP), INDEX)
    assert told.told(stands, at(LEFT), INDEX).tolist() == [0.0, 0.0, 0.0]


def test_height_and_pitch_are_told_after_the_velocity_also_while_standing() -> None:
    told = command(kind="velocity", height=[0.2, 0.4], pitch=[-0.5, 0.5], standing=1)
    assert told.drawn(np.array([1, 1, 1, 0, 0.5, 0.75]), at(UP), INDEX).tolist() == pytest.approx(
        [0, 0, 0, 0.3, 0.25]
    )
    assert [(part.name, part.unit) for part in told.ranges[3:]] == [("height", "m"), ("pitch", "rad")]
    with pytest.raises(ValidationError, match="give `height`"):
        command(kind="velocity", pitch=[0, 0])


def test_a_point_is_told_as_seen_from_the_root() -> None:
    told = command(kind="position", x=[-2, 2], y=[0, 4], standing=0.5)
    assert isinstance(told, PositionCommand)
    # From (1, 2) by (1, 3) to (2, 5): 3 m ahead and 1 m to the right of who looks along y.
    target = told.drawn(np.array([0.75, 0.75, 0.6]), at(LEFT), INDEX)
    assert target.tolist() == [2, 5]
    assert told.told(target, at(LEFT), INDEX).tolist() == pytest.approx([3, -1])
    assert told.drawn(np.array([0.75, 0.75, 0.4]), at(LEFT), INDEX).tolist() == [1, 2]


LEANS = [0, 0, 0.6, np.cos(0.15), 0, np.sin(0.15), 0, 0]


@pytest.mark.parametrize(
    ("term", "told", "expected"),
    [
        # The root is 0.6 m up and leans 0.3 rad forward.
        ({"kind": "track_height"}, {"command": np.array([0, 0, 0, 0.5, 0.1])}, np.exp(-1)),
        ({"kind": "track_pitch"}, {"command": np.array([0, 0, 0, 0.5, 0.1])}, np.exp(-1)),
        ({"kind": "track_position"}, {"target": np.array([3.0, 4.0])}, 1 - np.tanh(2.5)),
        ({"kind": "track_position", "tolerance": 1}, {"target": np.zeros(2)}, 1),
    ],
)
def test_following_is_worth_what_the_formula_says(
    term: dict[str, Any], told: dict[str, Any], expected: float
) -> None:
    made = TypeAdapter[Any](AnyReward).validate_python(term)
    assert made.measure(at(LEANS, **told), INDEX) == pytest.approx(expected, abs=1e-5)


def test_a_point_stays_where_it_is_while_the_root_moves(tmp_path: Path) -> None:
    environment = build(
        tmp_path,
        command={"kind": "position", "every_s": 0.03, "standing": 0},
        observation=[{"kind": "command"}],
        reward=[{"kind": "track_position"}],
        termination=[],
    )
    state, step = environment.reset(KEY), jax.jit(environment.step)
    point = np.asarray(state.obs)
    places = list[Any]()
    for number in range(4):
        at_x = 0.1 * (number + 1)
        state = step(moving(state, qpos=[at_x, 0, 0.5, 1, 0, 0, 0, 0], qvel=[0.0] * 7), NO_TORQUE)
        distance = np.linalg.norm(point - [at_x, 0])
        if number < 3:  # The third step is judged by the point that its action knew.
            assert float(state.reward) == pytest.approx(1 - np.tanh(distance / 2), abs=1e-4)
            assert float(state.metrics["position_error"]) == pytest.approx(distance, abs=1e-4)
        places.append(np.asarray(state.obs) + np.array([at_x, 0]))
    np.testing.assert_allclose(places[:2], [point, point], atol=1e-4)
    np.testing.assert_allclose(places[2], places[3], atol=1e-4)
    assert abs(places[2] - point).max() > 0.1


VELOCITY, TRACKS = {"kind": "velocity"}, {"kind": "track_linear_velocity"}
POSITION, STANDS = {"kind": "position"}, {"kind": "stand_still"}


@pytest.mark.parametrize(
    ("given", "pointer", "sentence"),
    [
        ({"command": POSITION, "reward": [STANDS]}, "/command", "add `track_position`"),
        (
            {"command": {**VELOCITY, "height": [0.2, 0.4]}, "reward": [TRACKS]},
            "/command/height",
            "reads the command's height: add `track_height`",
        ),
        ({"command": VELOCITY, "reward": [TRACKS, {"kind": "track_height"}]}, "/reward/1", "with a `height`"),
        (
            {"command": POSITION, "reward": [{"kind": "track_position"}, TRACKS]},
            "/reward/1",
            "kind `velocity`",
        ),
        ({"root": "arm", "command": VELOCITY, "reward": [STANDS]}, "/command", "'arm' has none"),
    ],
)
def test_a_command_that_nothing_could_follow_is_refused(
    given: dict[str, Any], pointer: str, sentence: str
) -> None:
    (problem,) = problems(parsed(**given), PROBE)
    assert problem.pointer == f"/environment/options{pointer}"
    assert sentence in problem.detail
