"""Which row an environment is in, and which action a column is."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import TypeAdapter

from core.algorithms.q_learning.discrete_env import Tabular, make_action_set, make_state_discretizer
from core.algorithms.q_learning.spec import ActionSetOptions, StateDiscretizerOptions
from core.environments.environment import ActionSet, Discretization, StateDiscretizer
from core.environments.wrappers.domain_randomization import RandomizedEnvironment
from core.errors import JobFailed
from tests import probes
from tests.learning.q_probes import PlanarStar

STATE_DISCRETIZER: TypeAdapter[Any] = TypeAdapter(StateDiscretizerOptions)
ACTION_SET: TypeAdapter[Any] = TypeAdapter(ActionSetOptions)


def state_discretizer(num_arms: int = 5, **options: Any) -> StateDiscretizer:
    star = PlanarStar(num_arms, observation_size=3)
    return make_state_discretizer(STATE_DISCRETIZER.validate_python(options), star)


def seen(bearing_deg: float, yaw_deg: float = 0.0) -> dict[str, Any]:
    bearing, yaw = np.deg2rad([bearing_deg, yaw_deg])
    return {
        "xy_direction_to_target": jnp.array([np.cos(bearing), np.sin(bearing)]),
        "disk_rotation": jnp.array([0.0, 0.0, yaw]),
    }


@pytest.mark.parametrize(
    ("bearing", "yaw", "arm"),
    # Five arms: sectors of 72° around 0°, 72°, 144°, 216°, 288°, as in the notebook's bins.
    [(0, 0, 0), (35, 0, 0), (37, 0, 1), (-35, 0, 0), (-37, 0, 4), (180, 0, 3), (179, 0, 2), (-145, 0, 3),
     (0, 72, 4), (170, -170, 0), (-170, 170, 0)],
)  # fmt: skip
def test_the_arm_towards_the_target_is_that_of_its_sector_however_the_disk_lies(
    bearing: float, yaw: float, arm: int
) -> None:
    np.testing.assert_array_equal(state_discretizer(kind="arm_towards_target")(seen(bearing, yaw)), [arm])


def test_each_arm_reads_how_far_round_the_target_lies_from_itself() -> None:
    # Towards arm 1: it reads 0, the arm before it 1 step on, and those behind it the way around.
    np.testing.assert_array_equal(state_discretizer(kind="arm_role")(seen(72)), [1, 0, 4, 3, 2])
    np.testing.assert_array_equal(state_discretizer(3, kind="arm_role")(seen(240)), [2, 1, 0])


def test_each_arm_reads_on_which_side_of_the_way_to_the_target_it_is() -> None:
    # Towards arm 1 at 72°: arms 2 and 3, further on counter-clockwise, are on the left, 0 and 4 on the right.
    np.testing.assert_array_equal(state_discretizer(kind="arm_side")(seen(72)), [2, 0, 1, 1, 2])
    # Of four arms, the one behind arm 1 is on neither side.
    np.testing.assert_array_equal(state_discretizer(4, kind="arm_side")(seen(90)), [2, 0, 1, 3])


def test_a_grid_counts_along_its_last_component_and_ends_at_its_edges() -> None:
    grid = state_discretizer(kind="disk_position_grid", x=[-1.0, 1.0], y=[0.0, 3.0], cells=[2, 3])
    places = [(-0.5, 0.5), (-0.5, 2.5), (0.5, 0.5), (0.0, 1.0), (9.0, 9.0), (-9.0, -9.0)]
    rows = [int(grid({"disk_position": jnp.array([x, y, 0.1])})[0]) for x, y in places]
    assert rows == [0, 2, 3, 4, 5, 0]
    assert grid.num_states == 6
    parts = [{"index": 2, "range": [0.0, 4.0], "cells": 4}, {"index": 0, "range": [0.0, 2.0], "cells": 2}]
    three = state_discretizer(
        kind="observation_grid", components=[*parts, {"index": 1, "range": [0, 1], "cells": 1}]
    )
    assert three({"observation": jnp.array([1.5, 0.0, 3.5])}).tolist() == [3 * 2 + 1]


def test_what_is_not_finite_has_no_row() -> None:
    broken = seen(0) | {"disk_rotation": jnp.array([0.0, 0.0, jnp.nan])}
    assert state_discretizer(kind="arm_towards_target")(broken).tolist() == [-1]
    assert state_discretizer(kind="arm_role")(broken).tolist() == [-1] * 5


def test_arms_put_their_parts_of_an_action_one_after_the_other() -> None:
    action_set = make_action_set(
        ACTION_SET.validate_python({"kind": "arm_actions", "actions": [[-1.0], [0.5]]}), PlanarStar()
    )
    assert action_set.act(jnp.array([0, 1, 0, 0, 1])).tolist() == [-1.0, 0.5, -1.0, -1.0, 0.5]


class Generator(PlanarStar):
    """It offers action sets, as `core.environments.cpg` does."""

    @property
    def discretization(self) -> Discretization:
        sets = {
            "leading_arm": ActionSet(5, 1, lambda choices: jnp.eye(5)[choices[0]]),
            "arm_roles": ActionSet(3, 5, lambda choices: choices / 4, ("leading", "left", "right")),
        }
        return replace(super().discretization, action_sets=sets)


def test_an_environment_s_own_action_sets_are_found_through_what_is_around_it() -> None:
    wrapped = RandomizedEnvironment(Generator(), {})
    leading = make_action_set(ACTION_SET.validate_python({"kind": "leading_arm"}), wrapped)
    assert (leading.num_choices, leading.act(jnp.array([3])).tolist()) == (5, [0, 0, 0, 1, 0])
    roles = make_action_set(ACTION_SET.validate_python({"kind": "arm_roles"}), wrapped)
    assert (roles.num_choices, roles.act(jnp.array([0, 1, 2, 2, 0])).tolist()) == (3, [0, 0.25, 0.5, 0.5, 0])
    assert roles.names == ("leading", "left", "right")


@pytest.mark.parametrize(
    ("reads", "chooses", "environment", "sentence"),
    [
        ("arm_towards_target", {"kind": "leading_arm"}, PlanarStar(), "offers no action set 'leading_arm'"),
        (
            "arm_towards_target",
            {"kind": "actions", "actions": [[0.5]]},
            probes.endless(),
            "offers no state discretizer 'arm_towards_target'",
        ),
        (
            "disk_position_grid",
            {"kind": "actions", "actions": [[0.5]]},
            probes.endless(),
            "looks at disk_position, and the environment tells nothing",
        ),
        ("arm_role", {"kind": "arm_actions", "actions": [[1, 1]]}, PlanarStar(), "have 2 components, .* 5"),
        (
            "arm_role",
            {"kind": "actions", "actions": [[0.5] * 5]},
            PlanarStar(),
            "5 rows .* takes 1 choice",
        ),
        (
            "observation_grid",
            {"kind": "actions", "actions": [[0.5] * 5]},
            PlanarStar(),
            "The observation has 1 components, and none of index 1",
        ),
    ],
)
def test_an_environment_that_lacks_what_is_needed_ends_the_job_with_the_reason(
    reads: str, chooses: dict[str, Any], environment: Any, sentence: str
) -> None:
    cut = {"components": [{"index": 1, "range": [0, 1], "cells": 2}]} if reads == "observation_grid" else {}
    state_discretizer = STATE_DISCRETIZER.validate_python({"kind": reads, **cut})
    with pytest.raises(JobFailed, match=sentence) as failure:
        Tabular.of(state_discretizer, ACTION_SET.validate_python(chooses), environment)
    assert failure.value.reason == "bad_model"
