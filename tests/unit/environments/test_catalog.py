"""The catalog as the API sees it."""

import subprocess
import sys
from typing import Any

import pytest

from core.algorithms.catalog import resolve, tuned
from core.algorithms.dqn import tuned as dqn_tuned
from core.algorithms.ppo import tuned as ppo_tuned
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.q_learning import tuned as q_learning_tuned
from core.algorithms.sac import tuned as sac_tuned
from core.algorithms.sac.spec import SACSpec
from core.environments import catalog
from core.environments.info import Device, EnvironmentInfo
from core.environments.locomotion.ant import AntOptions
from core.errors import EnvironmentNotFound, Rejected
from core.physics import availability
from core.physics.availability import choose

INFOS = list(catalog.ENVIRONMENTS.values())


def pointers(refusal: pytest.ExceptionInfo[Rejected]) -> list[str]:
    return [problem.pointer for problem in refusal.value.problems]


def test_a_mistyped_environment_is_answered_with_the_nearest_name_and_all_of_them() -> None:
    with pytest.raises(EnvironmentNotFound, match="Did you mean 'half_cheetah'") as refusal:
        catalog.find("halfcheetah")
    assert refusal.value.facts["environments"] == list(catalog.ENVIRONMENTS)


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("playground/cheetah_run", "playground/CheetahRun"),
        ("CheetahRun", "playground/CheetahRun"),
        ("brax/antt", "brax/ant"),
        ("antt", "ant"),
    ],
)
def test_the_environments_of_other_packages_are_near_by_their_own_names(said: str, meant: str) -> None:
    with pytest.raises(EnvironmentNotFound, match=f"Did you mean '{meant}'"):
        catalog.find(said)


@pytest.mark.parametrize(
    ("environment", "why"),
    [
        ("playground/Go1JoystickFlatTerrain", "Menagerie"),
        ("playground/ReacherEasy", "cannot load it with MuJoCo"),
        ("brax/swimmer", "cannot step it with jax"),
        ("brax/fast", "Brax's own tests"),
    ],
)
def test_what_another_package_has_and_no_worker_can_load_is_refused_with_the_reason(
    environment: str, why: str
) -> None:
    with pytest.raises(EnvironmentNotFound, match=why) as refusal:
        catalog.find(environment)
    assert environment not in refusal.value.facts["environments"]


def test_our_own_environments_come_first() -> None:
    families = [info.family for info in catalog.ENVIRONMENTS.values()]
    assert families == sorted(families, key=["gaitway", "playground", "brax"].index)
    assert set(families) == {"gaitway", "playground", "brax"}


def test_a_name_like_no_other_gets_no_guess() -> None:
    with pytest.raises(EnvironmentNotFound, match=r"'zzz'\. There are ant"):
        catalog.find("zzz")


@pytest.mark.parametrize(
    ("body", "options", "expected"),
    [
        ("rodent", {"n_frames": 2, "timestep": 0.005}, 0.01),
        ("go1", {}, 0.02),
        ("go1", {"n_frames": 2}, 0.01),  # of 0.005 s
        ("go1", {"timestep": 0.004}, 0.02),  # as many as fill 0.02 s
    ],
)
def test_the_seconds_of_an_action_follow_from_the_options(
    body: str, options: dict[str, Any], expected: float
) -> None:
    info, _ = catalog.resolve(body, options)
    assert info.dt == expected


def test_options_that_are_not_given_take_their_defaults() -> None:
    options = catalog.parse_options(catalog.find("ant"), {"healthy_z_range": [0.3, 0.9]})
    assert options == AntOptions(healthy_z_range=(0.3, 0.9))


@pytest.mark.parametrize(
    ("environment", "options", "pointer", "sentence"),
    [
        ("ant", {"leg_count": 6}, "/environment/options/leg_count", "there is no such option"),
        ("ant", {"ctrl_cost_weight": "1"}, "/environment/options/ctrl_cost_weight", "valid number"),
        ("ant", {"ctrl_cost_weight": float("nan")}, "/environment/options/ctrl_cost_weight", "finite"),
        ("ant", {"reset_noise_scale": -1.0}, "/environment/options/reset_noise_scale", "greater"),
        ("ant", {"use_contact_forces": True}, "/environment/options/use_contact_forces", "False"),
        ("ant", {"healthy_z_range": [1.0, 0.2]}, "/environment/options/healthy_z_range", "low < high"),
        ("ant", {"healthy_z_range": [0.2]}, "/environment/options/healthy_z_range/1", "required"),
        ("hopper", {"healthy_z_range": [2, 1]}, "/environment/options/healthy_z_range", "low < high"),
        ("reacher", {"a/b": 1}, "/environment/options/a~1b", "there are none"),
    ],
)
def test_a_wrong_option_is_refused_with_its_place(
    environment: str, options: dict[str, object], pointer: str, sentence: str
) -> None:
    with pytest.raises(Rejected, match=sentence) as refusal:
        catalog.parse_options(catalog.find(environment), options)
    assert pointers(refusal) == [pointer]


def test_every_wrong_option_is_named() -> None:
    with pytest.raises(Rejected) as refusal:
        catalog.parse_options(catalog.find("ant"), {"healthy_reward": "x", "colour": "red"})
    assert set(pointers(refusal)) == {
        "/environment/options/healthy_reward",
        "/environment/options/colour",
    }


def test_a_bound_may_be_left_open_above() -> None:
    options = catalog.parse_options(catalog.find("hopper"), {"healthy_z_range": [0.5, None]})
    assert options.model_dump()["healthy_z_range"] == (0.5, None)


@pytest.mark.parametrize("info", INFOS, ids=lambda info: info.id)
@pytest.mark.parametrize("device", ["cpu", "gpu"])
def test_tuned_values_are_complete_and_go_together(info: EnvironmentInfo, device: Device) -> None:
    values = tuned("ppo", info, device)
    resolved = resolve(PPOSpec(), info, device)
    assert resolved.model_dump(include=set(values)) == values
    assert resolved.episode_length == info.episode_length
    if info.id in catalog.BUILT_IN:  # Other packages' settings are theirs.
        of_ppo = ppo_tuned.tuned(info, device).model_fields_set
        assert of_ppo, (
            f"{info.id!r} lacks tuned values of PPO for {device!r}: see core/algorithms/ppo/tuned.py"
        )
        # On a GPU an evaluation takes a second or more, however many train side by side.
        assert device == "cpu" or resolved.num_evals <= 4
    assert resolved.batch_size * resolved.num_minibatches % resolved.num_envs == 0


@pytest.mark.parametrize("info", [catalog.find(name) for name in sac_tuned.TUNED], ids=lambda info: info.id)
def test_tuned_values_of_sac_go_together(info: EnvironmentInfo) -> None:
    values = tuned("sac", info, "gpu")
    assert resolve(SACSpec(), info, "gpu").model_dump(include=set(values)) == values
    assert {"num_timesteps", "num_envs", "value_min", "value_max", "learning_rate"} <= set(values)


def test_tuned_values_belong_to_environments_that_there_are() -> None:
    named = {*ppo_tuned.TUNED, *ppo_tuned.TUNED_BY_OPTIONS, *q_learning_tuned.TUNED_BY_OPTIONS}
    named |= {*sac_tuned.TUNED, *dqn_tuned.TUNED_BY_OPTIONS}
    assert named <= set(catalog.ENVIRONMENTS)


@pytest.mark.parametrize("info", INFOS, ids=lambda info: info.id)
def test_an_environment_can_be_described_in_json(info: EnvironmentInfo) -> None:
    schema = info.options.model_json_schema()
    options = info.options(**({"model": "sha256:" + "0" * 64} if info.takes_model else {}))
    assert info.options.model_validate_json(options.model_dump_json()) == options
    assert set(schema.get("properties", {})) == set(info.options.model_fields)


def test_reading_the_catalog_loads_no_numerical_code() -> None:
    program = (
        "import sys, core.environments.catalog, core.physics.availability;"
        "print(sorted({'jax', 'mujoco', 'numpy', 'brax'} & set(sys.modules)))"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


LOCOMOTION = {"ant", "half_cheetah", "hopper", "humanoid", "walker2d"}
ROBOTS = {"g1", "go1"}
STARS = {"brittle_star", "brittle_star_light_escape", "brittle_star_undirected"}


@pytest.mark.parametrize(
    ("device", "num_envs", "more"),
    [
        ("cpu", 4096, {"corridor", "reacher", "rodent", "mjcf", *ROBOTS, *STARS}),
        # A rollout of one episode: the others take longer to compile than C MuJoCo takes for it.
        ("cpu", 1, {"reacher", *ROBOTS}),
        ("gpu", 4096, {"corridor", "rodent", *ROBOTS, *STARS}),
        ("gpu", 1, {"corridor", "rodent", *ROBOTS, *STARS}),
    ],
)
def test_auto_takes_compiled_for_the_bodies_it_was_measured_on_where_it_is_installed(
    device: Device, num_envs: int, more: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # One environment is a rollout, which so has the engine of the training that it shows.
    def chosen(environment: str) -> str:
        info = catalog.find(environment)
        return choose("auto", device, num_envs, info.rules_on(device), info.cannot_run).name

    monkeypatch.setattr(availability, "find_spec", lambda name: True)
    assert {name for name in catalog.BUILT_IN if chosen(name) == "compiled"} == LOCOMOTION | more
    monkeypatch.setattr(availability, "find_spec", lambda name: None)
    assert {chosen(name) for name in LOCOMOTION} == {"native" if device == "cpu" else "mjx"}
    assert {chosen(name) for name in more - ROBOTS} <= {"native"}
