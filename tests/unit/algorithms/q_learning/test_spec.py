"""What a client may ask of Q-learning, and what is refused with its place."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from core.algorithms.catalog import resolve
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.q_learning.tuned import TUNED_BY_OPTIONS
from core.algorithms.spec import check_resumption
from core.environments import catalog
from core.environments.info import FiniteSpace, FiniteViews
from core.errors import Rejected
from core.jobs.resolved import resolve_job
from core.jobs.spec import JOB_SPEC, TrainSpec
from core.jobs.submission import completed

STAR = replace(
    catalog.find("ant"),
    id="star",
    observation_size=3,
    action_size=5,
    info=("disk_position", "disk_rotation", "xy_direction_to_target"),
    finite=FiniteViews(
        {"arm_towards_target": FiniteSpace(5), "arm_role": FiniteSpace(5, 5)},
        action_parts=5,
        cannot_offer={"leading_arm": "it has no generator"},
    ),
)


@pytest.fixture(autouse=True)
def tuned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TUNED_BY_OPTIONS, STAR.id, lambda options: {"cpu": QLearningSpec(num_envs=4)})


GRID: dict[str, Any] = {
    "kind": "observation_grid",
    "components": [{"index": 0, "range": [-1.0, 1.0], "cells": 4}],
}
ARM = {"kind": "arm_towards_target"}
ACTIONS = {"kind": "actions", "actions": [[1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0]]}
VALID: dict[str, Any] = {"state_discretizer": ARM, "action_set": ACTIONS}


def parsed(**fields: Any) -> QLearningSpec:
    document = {"kind": "train", "environment": "ant", "algorithm": {"kind": "q_learning", **fields}}
    spec = JOB_SPEC.validate_python(document)
    assert spec.model_dump(mode="json", exclude_unset=True)["algorithm"] == {"kind": "q_learning", **fields}
    return spec.algorithm  # pyright: ignore


@pytest.mark.parametrize(
    "fields",
    [
        {"state_discretizer": {"kind": "disk_position_grid", "cells": [0, 3]}},
        {"state_discretizer": {"kind": "disk_position_grid", "x": [1.0, 1.0]}},
        {"state_discretizer": {"kind": "observation_grid", "components": []}},
        {"state_discretizer": {"kind": "sectors"}},
        {"epsilon": {"start": 1.1}},
        {"epsilon": {"end": -0.1}},
        {"agents": []},
        {"agents": [{"learning_rate": 2.0}]},
        {"replay": {"buffer_size": 0}},
        {"action_set": {"kind": "actions", "actions": [[1.5]]}},
    ],
)
def test_a_value_out_of_its_range_is_refused_by_its_shape(fields: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        parsed(**fields)


@pytest.mark.parametrize(
    ("change", "sentence", "pointers"),
    [
        (
            {"action_set": None},
            "Name an `action_set`: the action of star is 5 continuous numbers",
            ["action_set"],
        ),
        ({"state_discretizer": None}, "Name a `state_discretizer`", ["state_discretizer"]),
        (
            {"action_set": {"kind": "leading_arm"}},
            "'leading_arm' under these options: it has no generator. It offers actions",
            ["action_set"],
        ),
        (
            {"state_discretizer": {"kind": "arm_role"}},
            "'arm_role' and the action set 'actions' do not go together: .* 5 rows .* takes 1",
            ["state_discretizer", "action_set"],
        ),
        (
            {"action_set": {"kind": "actions", "actions": [[1.0], [1.0, 0.0]]}},
            "takes 5 action components; the action set's actions have 1, 2",
            ["action_set/actions"],
        ),
        (
            {"epsilon": {"decay_episodes": 101}, "num_episodes": 100},
            "decay_episodes = 101, and the run has 100 episodes",
            ["epsilon/decay_episodes"],
        ),
        (
            {"epsilon": {"decay_decisions": 5001}, "decisions_per_episode": 50},
            "decay_decisions = 5,001, and the run has 5,000 decisions",
            ["epsilon/decay_decisions"],
        ),
        (
            {"epsilon": {"decay_decisions": 10, "decay_episodes": 10}},
            "not over both",
            ["epsilon/decay_episodes", "epsilon/decay_decisions"],
        ),
        ({"epsilon": {"end": 0.0, "shape": "exponential"}}, "never comes from or to 0", ["epsilon/shape"]),
        ({"replay": {"buffer_size": 3}}, "each decision brings 4 transitions", ["replay/buffer_size"]),
        (
            {"state_discretizer": {"kind": "disk_position_grid", "cells": [10_000, 10_000]}},
            "would have 200,000,000 cells",
            ["state_discretizer"],
        ),
        (
            {
                "state_discretizer": {
                    **GRID,
                    "components": [*GRID["components"], {**GRID["components"][0], "index": 3}],
                }
            },
            "The observation of star has 3 components, and none of index 3",
            ["state_discretizer/components/1/index"],
        ),
        (
            {
                "state_discretizer": {"kind": "arm_role"},
                "action_set": {"kind": "arm_actions", "actions": [[0.5, 0.5]]},
            },
            "star takes 5 action components in 5 equal parts; the action set's actions have 2",
            ["action_set/actions"],
        ),
        ({"initial_table": "identity"}, "this one has 5 rows and 2 columns", ["initial_table"]),
        (
            {
                "state_discretizer": {"kind": "arm_role"},
                "action_set": {"kind": "arm_actions", "actions": [[0.5], [0.0]]},
                "replay": {"buffer_size": 19},
            },
            "each decision brings 20 transitions",  # of 4 environments with 5 arms
            ["replay/buffer_size"],
        ),
        (
            {"replay": {"buffer_size": 10**7}, "agents": [{}] * 11},
            "keep 110,000,000 transitions",
            ["replay/buffer_size"],
        ),
        (
            {"num_envs": 2**19, "agents": [{}] * 3},
            "3 agents with 524,288 environments each are 1,572,864 environments",
            ["num_envs"],
        ),
    ],
)
def test_what_does_not_go_together_is_refused_with_its_places(
    change: dict[str, Any], sentence: str, pointers: list[str]
) -> None:
    spec = QLearningSpec.model_validate({**VALID, **change})
    with pytest.raises(Rejected, match=sentence) as caught:
        resolve(spec, STAR, "cpu")
    assert [problem.pointer for problem in caught.value.problems] == [f"/algorithm/{p}" for p in pointers]


def test_a_curriculum_is_refused_as_every_episode_begins_as_the_options_say() -> None:
    with pytest.raises(Rejected, match="a curriculum would change nothing") as caught:
        resolve(QLearningSpec.model_validate(VALID), replace(STAR, has_curriculum=True), "cpu")
    assert [problem.pointer for problem in caught.value.problems] == [
        "/environment/options/curriculum",
        "/algorithm/kind",
    ]


def test_a_table_is_as_large_as_its_columns_make_it_whoever_names_them() -> None:
    # 2.5 million rows, and as many columns as the generator's five arms.
    grid = {"kind": "disk_position_grid", "cells": [2500, 1000]}
    spec = QLearningSpec.model_validate({"state_discretizer": grid, "action_set": {"kind": "leading_arm"}})
    generator = FiniteViews(action_sets={"leading_arm": FiniteSpace(5)})
    with pytest.raises(Rejected, match="would have 12,500,000 cells; 10,000,000 are allowed"):
        resolve(spec, replace(STAR, finite=generator, action_size=36), "cpu")


def test_arms_that_differ_have_no_joints_in_common() -> None:
    stars = catalog.find("brittle_star")
    options = catalog.parse_options(stars, {"num_arms": 3, "num_segments_per_arm": [2, 1, 3]})
    arms = {"kind": "arm_actions", "actions": [[0.1] * 4, [0.0] * 4]}  # 12 joints of 3 arms
    spec = QLearningSpec.model_validate({"state_discretizer": {"kind": "arm_role"}, "action_set": arms})
    with pytest.raises(Rejected, match="'arm_actions' under these options: its arms differ in their joints"):
        resolve(spec, stars.under(options), "cpu")


@pytest.mark.parametrize(
    ("discretizer", "sentence"),
    [
        (
            ARM,
            "ant offers no state discretizer 'arm_towards_target' .* It offers observation_grid",
        ),
        (
            {"kind": "disk_position_grid"},
            "disk_position, and ant tells nothing besides its observation",
        ),
    ],
)
def test_an_environment_that_tells_no_direction_cannot_feed_a_discretizer_of_directions(
    discretizer: dict[str, Any], sentence: str
) -> None:
    actions = {"kind": "actions", "actions": [[0.0] * 8]}
    with pytest.raises(Rejected, match=sentence) as caught:
        resolve(parsed(state_discretizer=discretizer, action_set=actions), catalog.find("ant"), "cpu")
    assert [problem.pointer for problem in caught.value.problems] == ["/algorithm/state_discretizer"]


def test_tuned_values_lie_under_the_jobs_word_and_budgets_are_whole_rounds() -> None:
    # 10 episodes in 4 environments are 3 rounds of 4; 2 agents of 4 environments, 5 decisions of 2 steps: 80
    # steps each.
    fields = {
        **VALID,
        "num_episodes": 10,
        "decisions_per_episode": 5,
        "decision_steps": 2,
        "agents": [{}, {}],
    }
    settings = resolve(parsed(**fields), STAR, "cpu")
    assert (settings.num_envs, settings.num_parallel_envs, settings.num_updates) == (4, 8, 3)
    assert (settings.env_steps_per_update, settings.budget, settings.num_decisions) == (80, 240, 60)
    assert resolve(parsed(**VALID), STAR, "gpu").num_envs == 10


def test_a_table_of_another_shape_or_another_algorithm_cannot_go_on() -> None:
    made_with = parsed(state_discretizer=GRID, action_set=ACTIONS)
    finer = {"kind": "observation_grid", "components": [{"index": 0, "range": [-1.0, 1.0], "cells": 8}]}
    with pytest.raises(Rejected, match="The checkpoint was made with state_discretizer") as caught:
        check_resumption(parsed(state_discretizer=finer, action_set=ACTIONS), made_with)
    assert [problem.pointer for problem in caught.value.problems] == ["/algorithm/state_discretizer"]
    with pytest.raises(Rejected, match="made with kind = q_learning; this job has ppo"):
        check_resumption(PPOSpec(), made_with)
    free = {"learning_rate": 0.9, "num_episodes": 5, "epsilon": {"start": 0.1}, "policy_agent": "first"}
    check_resumption(parsed(state_discretizer=GRID, action_set=ACTIONS, **free), made_with)


def test_several_gpus_are_refused() -> None:
    with pytest.raises(Rejected, match="runs on one device, but the job asks for 2 GPUs"):
        parsed(**VALID).check_sharing(2)


def test_the_jobs_of_the_page_are_jobs() -> None:
    page = (Path(__file__).parents[4] / "docs" / "q_learning.md").read_text()
    jobs = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    assert len(jobs) == 4
    for job in jobs:
        spec = completed(JOB_SPEC.validate_json(job))
        assert isinstance(spec, TrainSpec)
        assert resolve_job(spec).settings_on("cpu").algorithm() == "q_learning"
