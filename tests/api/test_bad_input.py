"""Whatever is wrong with a submission: a problem, a sentence, a pointer; and nothing stored or queued."""

import socket
from collections.abc import Iterator
from typing import Any

import pytest

from tests.api.conftest import Stack
from tests.api.problems import pointers, problem

MINIMAL = {"kind": "train", "environment": "ant"}
NO_JOB = "019aa3c2f0b1-5be0c1d2e3"


def rollout(**policy: Any) -> dict[str, Any]:
    return {"kind": "rollout", "environment": "ant", "policy": policy}


def q_learning(**options: Any) -> dict[str, Any]:
    return MINIMAL | {"algorithm": {"kind": "q_learning", **options}}


def sac(**options: Any) -> dict[str, Any]:
    return MINIMAL | {"algorithm": {"kind": "sac", **options}}


def dqn(**options: Any) -> dict[str, Any]:
    return MINIMAL | {"algorithm": {"kind": "dqn", **options}}


def corridor(**options: Any) -> dict[str, Any]:
    return {"kind": "train", "environment": {"id": "corridor", "options": options}}


COMMAND = {"kind": "command"}


def go1(**options: Any) -> dict[str, Any]:
    return {"kind": "train", "environment": {"id": "go1", "options": options}}


def star(**options: Any) -> dict[str, Any]:
    return {"kind": "train", "environment": {"id": "brittle_star", "options": options}}


@pytest.fixture(autouse=True)
def nothing_is_kept(stack: Stack) -> Iterator[None]:
    yield
    assert stack.is_empty()


@pytest.mark.parametrize(
    ("body", "pointer", "words"),
    [
        ({"kind": "train", "environment": "unicorn"}, "/environment", "no environment 'unicorn'"),
        ({"kind": "train", "environment": {"id": "antt"}}, "/environment", "'ant'?"),
        ({"kind": "train"}, "/environment", "`environment` is missing."),
        (
            {"kind": "rollout", "policy": {"kind": "zero"}},
            "/environment",
            "`environment` is missing; only a rollout of a checkpoint may leave it out.",
        ),
        (
            {"kind": "train", "environment": "mjcf", "model": "sha256:0"},
            "/model",
            "`model` is not a field here; did you mean `environment.options.model`?",
        ),
        (MINIMAL | {"learning_rate": 1}, "/learning_rate", "did you mean `algorithm.learning_rate`?"),
        (MINIMAL | {"num_timestep": 1}, "/num_timestep", "did you mean `algorithm.num_timesteps`?"),
        (
            MINIMAL | {"environment": "Go1JoystickFlatTerrian"},
            "/environment",
            "'playground/Go1JoystickFlatTerrain' is like it, but is not available here",
        ),
        (MINIMAL | {"battery": True}, "/battery", "this task of ant has neither: leave `battery` out."),
        (
            MINIMAL | {"environment": "rodent", "battery": True},
            "/battery",
            'leave `battery` out, or take `task`: "imitate" and a `reference`.',
        ),
        (
            {"kind": "rollout", "environment": "go1", "policy": {"kind": "zero"}, "battery": {}},
            "/battery",
            "A battery tests a trained policy",
        ),
        (MINIMAL | {"battery": {"seconds": 1}}, "/battery/seconds", "2"),
        ({"environment": "ant"}, "/kind", "`kind` is missing"),
        ({"kind": "trian", "environment": "ant"}, "/kind", "did you mean `train`?"),
        ({"kind": "zzz", "environment": "ant"}, "/kind", "known are `train`, `rollout`."),
        ([], "", "must be an object"),
        ("text", "", "must be an object"),
        (
            MINIMAL | {"algorithm": {"kind": "td3"}},
            "/algorithm/kind",
            "known are `ppo`, `dqn`, `q_learning`, `sac`, `distillation`",
        ),
        (MINIMAL | {"algorithm": "ppo"}, "/algorithm", "must be an object"),
        (
            MINIMAL | {"algorithm": {"kind": "ppo", "clip_epsilon": 0.2}},
            "/algorithm/clip_epsilon",
            "`clip_epsilon` is not a field here; did you mean `clipping_epsilon`?",
        ),
        (
            MINIMAL
            | {"environment": {"id": "brittle_star", "options": {"control": "joints"}}}
            | {"algorithm": {"kind": "q_learning"}},
            "/algorithm/action_set",
            "50 continuous numbers, and a table has columns",
        ),
        (q_learning(), "/algorithm/action_set", "8 continuous numbers, and a table has columns"),
        (
            q_learning(state_discretizer={"kind": "arm_role"}),
            "/algorithm/state_discretizer",
            "ant offers no state discretizer",
        ),
        (
            q_learning(action_set={"kind": "leading_arm"}),
            "/algorithm/action_set",
            "ant offers no action set",
        ),
        (
            q_learning(action_set={"kind": "arm_amplitudes"})
            | {"environment": {"id": "brittle_star", "options": {"control": "joints"}}},
            "/algorithm/action_set",
            "it has a central pattern generator only with the option \"control\": \"cpg\"",
        ),
        (
            q_learning(action_set={"kind": "arm_amplitudes"})
            | {
                "environment": {
                    "id": "brittle_star",
                    "options": {"control": "cpg", "num_segments_per_arm": [5, 0, 5, 0, 5]},
                }
            },
            "/algorithm/action_set",
            "num_segments_per_arm leaves out arm 1, 3",
        ),
        (q_learning(epsilon={"start": 1.5}), "/algorithm/epsilon/start", "less than or equal to 1, not 1.5"),
        (
            q_learning(state_discretizer={"kind": "disk_position_grid", "cells": [0, 5]}),
            "/algorithm/state_discretizer/cells/0",
            "greater than or equal to 1, not 0",
        ),
        (
            q_learning(state_discretizer={"kind": "disk_position_grid", "x": [2, 1]}),
            "/algorithm/state_discretizer/x",
            "`x`: [2, 1] is not [low, high] with low < high.",
        ),
        (
            q_learning(epsilon={"decay_episodes": 500}),
            "/algorithm/epsilon/decay_episodes",
            "the run has 100 episodes",
        ),
        (q_learning(epsilom={}), "/algorithm/epsilom", "did you mean `epsilon`?"),
        (sac(entropy_cost=0.1), "/algorithm/entropy_cost", "`entropy_cost` is not a field here"),
        (sac(tau=0), "/algorithm/tau", "greater than 0, not 0"),
        (
            sac(value_min=5, value_max=5),
            "/algorithm/value_min",
            "value_min = 5 is not below value_max = 5",
        ),
        (
            sac(max_replay_size=1000),
            "/algorithm/max_replay_size",
            "it has to keep 8: 1024 or more",
        ),
        (sac(num_timesteps=1000), "/algorithm/min_replay_size", "The run ends after 1024 transitions"),
        (
            sac() | {"resources": {"gpus": 2}},
            "/resources/gpus",
            "sac runs on one device, but the job asks for 2 GPUs.",
        ),
        (dqn(), "/algorithm/action_set", "8 continuous numbers, and the network has an output for each"),
        (dqn(action_set={"kind": "leading_arm"}), "/algorithm/action_set", "ant offers no action set"),
        (
            dqn(action_set={"kind": "actions", "actions": [[1.0, 0.0]]}),
            "/algorithm/action_set/actions",
            "ant takes 8 action components",
        ),
        (dqn(state_discretizer={"kind": "arm_role"}), "/algorithm/state_discretizer", "is not a field here"),
        (dqn(epsilon={"decay_episodes": 5}), "/algorithm/epsilon/decay_episodes", "is not a field here"),
        (
            dqn(action_set={"kind": "actions", "actions": [[1.0] * 8]}) | {"resources": {"gpus": 2}},
            "/resources/gpus",
            "dqn runs on one device",
        ),
        (MINIMAL | {"enviroment": "ant"}, "/enviroment", "did you mean `environment`?"),
        (MINIMAL | {"a/b~c": 1}, "/a~1b~0c", "not a field here"),
        (MINIMAL | {"video": {"camera": "moon"}}, "/video/camera", "no camera 'moon'"),
        (MINIMAL | {"video": {"camera": 99}}, "/video/camera", "no camera 99"),
        (MINIMAL | {"video": {"camera": 10**400}}, "/video/camera", "equal to 10000"),
        (MINIMAL | {"video": {"camera": 1.5}}, "/video/camera", "valid string"),
        (MINIMAL | {"video": {"cameras": ["track", "moon"]}}, "/video/cameras/1", "no camera 'moon'"),
        (MINIMAL | {"video": {"cameras": [0, "track", "track"]}}, "/video/cameras/2", "already listed"),
        (MINIMAL | {"video": {"cameras": []}}, "/video/cameras", "at least 1"),
        (MINIMAL | {"video": {"cameras": ["track"], "camera": "track"}}, "/video", "give one of them"),
        (MINIMAL | {"video": {"cameras": [0, "track"], "width": 1920}}, "/video/width", "of 3844 × 480"),
        (MINIMAL | {"video": {"episodes": 0}}, "/video/episodes", "greater than or equal to 1"),
        (MINIMAL | {"video": {"episodes": 65}}, "/video/episodes", "less than or equal to 64"),
        (MINIMAL | {"video": {"episodes": 4, "height": 960}}, "/video/episodes", "of 638 × 956 would fit"),
        (MINIMAL | {"video": {"show": ["bones"]}}, "/video/show/0", "'joints', 'contacts'"),
        (MINIMAL | {"video": {"width": 17}}, "/video/width", "must be even"),
        (MINIMAL | {"seed": -1}, "/seed", "greater than or equal to 0, not -1"),
        (MINIMAL | {"seed": 10**400}, "/seed", "not an integer of very many digits"),
        (MINIMAL | {"seed": "0"}, "/seed", "valid integer, not '0'"),
        (MINIMAL | {"timeout_s": 10**400}, "/timeout_s", "finite number"),
        (MINIMAL | {"timeout_s": True}, "/timeout_s", "must be a valid number, not true"),
        (MINIMAL | {"labels": {"white space": "x"}}, "/labels/white space", "must match"),
        (MINIMAL | {"labels": {"null\0": "x"}}, "/labels/null\0", "must match"),
        (MINIMAL | {"labels": {"null": "x\0"}}, "/labels/null", "must not contain the character U+0000"),
        (MINIMAL | {"name": "\0"}, "/name", "must not contain the character U+0000"),
        (MINIMAL | {"environment": "ant\0"}, "/environment", "no environment 'ant\\x00'"),
        (corridor(walker="\0"), "/environment/options/walker", "should be 'ant'"),
        (
            {"kind": "train", "environment": {"id": "mjcf", "options": {"model": "sha256:\0"}}},
            "/environment/options/model",
            "sha256",
        ),
        (
            MINIMAL | {"environment": {"id": "ant", "options": {"gravity": 0}}},
            "/environment/options/gravity",
            "no such option",
        ),
        (
            MINIMAL | {"randomization": [{"field": "body_mass", "range": [1]}]},
            "/randomization/0/range/1",
            "`range` has too few items",
        ),
        (
            go1(observation=[COMMAND], critic=[COMMAND, {"kind": "randomized", "field": "body_mass"}]),
            "/environment/options/critic/1/field",
            "No rule of `randomization` changes body_mass",
        ),
        (
            MINIMAL | {"randomization": [{"field": "mass", "range": [1, 2]}]},
            "/randomization/0/field",
            "'body_mass'",
        ),
        (
            MINIMAL
            | {"randomization": [{"field": "body_mass", "range": [1, 2], "names": ["torso", "tors"]}]},
            "/randomization/0/names/1",
            "The model has no body that 'tors' matches; did you mean 'torso'?",
        ),
        (
            go1(terrain={})
            | {"randomization": [{"field": "geom_friction", "range": [1, 2], "names": ["terrain .*", "x"]}]},
            "/randomization/0/names/1",
            "The model has no geom that 'x' matches",
        ),
        (
            MINIMAL | {"randomization": [{"field": "body_mass", "range": [2, 1]}]},
            "/randomization/0",
            "range must be [low, high]",
        ),
        (
            MINIMAL | {"tracking": {"wandb": {"project": "vnl", "api_key": "secret"}}},
            "/tracking/wandb/api_key",
            "not a field here",
        ),
        (MINIMAL | {"tracking": {"wandb": {"project": "a/b"}}}, "/tracking/wandb/project", "must match"),
        (MINIMAL | {"tracking": {"wandb": {}}}, "/tracking/wandb/project", "is missing"),
        (rollout(kind="zero") | {"tracking": {}}, "/tracking", "not a field here"),
        (MINIMAL | {"resume_from": {"job": "../../etc"}}, "/resume_from/job", "must match"),
        (rollout(kind="zero", action=[1]), "/policy/action", "not a field here"),
        (
            rollout(kind="zero") | {"num_episodes": 3, "video": {"episodes": 4}},
            "/video/episodes",
            "shows 4 episodes, but the rollout makes 3",
        ),
        (rollout(kind="dance"), "/policy/kind", "known are"),
        (rollout(kind="constant", action=[0.5]), "/policy/action", "8 action components"),
        (rollout(kind="constant", action=[0, 2]), "/policy/action/1", "less than or equal to 1, not 2"),
        (corridor() | {"video": {"camera": "walker/back"}}, "/video/camera", "walker/sideon"),
        (corridor(walker="rodent") | {"video": {"camera": 5}}, "/video/camera", "by number 0 to 4"),
        (
            corridor(walker="rodent") | {"physics": "mjx"},
            "/physics",
            "no contacts between ellipsoids and boxes",
        ),
        (
            star(walls="contacts", num_segments_per_arm=12) | {"physics": "mjx"},
            "/physics",
            "MJX does not compile in time",
        ),
        (corridor(walker="fruitfly"), "/environment/options/walker", "dm_control measures it in centimetres"),
        (
            corridor(curriculum={"start": {"gap_length": [0, 50]}, "over_steps": 1000}),
            "/environment/options",
            "as the curriculum begins, gap_length goes up to 50 m",
        ),
        (
            corridor(curriculum={"start": {"gap_length": [-1, 0]}, "over_steps": 1000}),
            "/environment/options/curriculum/start/gap_length",
            "must not be negative",
        ),
        (corridor(aesthetic="sunset"), "/environment/options/aesthetic", "'default' or 'outdoor_natural'"),
        (corridor(observables=["mass"]), "/environment/options/observables/0", "'qfrc_actuator'"),
        (corridor(walker="rodent", contact_termination=True), "/environment/options", "on its forearms"),
        (corridor(gap_length=[2, 1]), "/environment/options/gap_length", "low ≤ high"),
        (corridor(gap_length=[1, 50]), "/environment/options", "gap_length goes up to 50 m"),
        (
            corridor(walker="humanoid") | {"kind": "rollout", "policy": {"kind": "constant", "action": [1]}},
            "/policy/action",
            "corridor takes 56 action components; 1 were given",
        ),
        (rollout(kind="checkpoint", job=NO_JOB), "/policy/job", "no job"),
        (rollout(kind="checkpoint", job=NO_JOB, step=1, which="best"), "/policy", "exclude each other"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_refused_with_its_place(stack: Stack, body: Any, pointer: str, words: str) -> None:
    document = problem(stack.http.post("/jobs", json=body), 422, "invalid-request")
    assert pointer in pointers(document)
    assert words in next(place["detail"] for place in document["errors"] if place["pointer"] == pointer)


def test_a_check_refuses_what_a_submission_would_be_refused_for(stack: Stack) -> None:
    for wrong in (MINIMAL | {"seed": -1}, go1(reward=[{"kind": "alive", "name": "A"}]), corridor(walker=1)):
        refused, checked = (stack.http.post(path, json=wrong) for path in ("/jobs", "/jobs/check"))
        assert problem(checked, 422, "invalid-request")["errors"] == refused.json()["errors"]
    accepted = stack.http.post("/jobs/check", json=MINIMAL)
    assert accepted.status_code == 200
    assert accepted.json()["environment"]["options"]["healthy_reward"] == 1.0
    again = stack.http.post("/jobs/check", json=accepted.json())
    assert again.json() == accepted.json()


@pytest.mark.parametrize(
    ("word", "shown"),
    [("NaN", "NaN"), ("Infinity", "Infinity"), ("-Infinity", "-Infinity"), ("1e999", "Infinity")],
)
def test_numbers_that_are_not_finite_are_refused(stack: Stack, word: str, shown: str) -> None:
    body = (
        f'{{"kind": "train", "environment": "ant", "algorithm": {{"kind": "ppo", "learning_rate": {word}}}}}'
    )
    answer = stack.http.post("/jobs", content=body, headers={"Content-Type": "application/json"})
    document = problem(answer, 422, "invalid-request")
    assert pointers(document) == ["/algorithm/learning_rate"]
    assert f"must be a finite number, not {shown}." in document["detail"]


def test_every_wrong_field_is_named_at_once(stack: Stack) -> None:
    body = MINIMAL | {"seed": -1, "priority": "urgent", "colour": "red"}
    document = problem(stack.http.post("/jobs", json=body), 422, "invalid-request")
    assert sorted(pointers(document)) == ["/colour", "/priority", "/seed"]


def test_a_hundred_thousand_unknown_fields_get_a_short_answer(stack: Stack) -> None:
    body = MINIMAL | {f"field{i}": 0 for i in range(60_000)}
    answer = stack.http.post("/jobs", json=body)
    problem(answer, 422, "invalid-request")
    assert len(answer.content) < 20_000


def test_batches_that_do_not_fit_the_environments_name_all_three_fields(stack: Stack) -> None:
    # 7 × 3 = 21 unrolls do not spread evenly over 256 environments.
    algorithm = {"kind": "ppo", "batch_size": 7, "num_minibatches": 3, "num_envs": 256}
    document = problem(
        stack.http.post("/jobs", json=MINIMAL | {"algorithm": algorithm}), 422, "invalid-request"
    )
    assert set(pointers(document)) == {
        "/algorithm/batch_size",
        "/algorithm/num_minibatches",
        "/algorithm/num_envs",
    }
    assert "21" in document["detail"]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"", "EOF while parsing a value at line 1 column 0"),
        (b"kind=train", "line 1 column 1"),
        (b'{"kind": "train",\n "environment": }', "line 2 column 17"),
        (b'{"kind": "train"} extra', "trailing characters"),
        (b"\xff\xfe{}", "line 1 column 1"),
        (b'{"kind": "tr\xffain"}', "unicode"),
        (b'{"name": "\\ud800"}', "hex escape"),
        (b"[" * 200_000, "recursion limit exceeded"),
        (b'{"seed": ' + b"9" * 5000 + b"}", "number out of range"),
    ],
)
def test_what_is_not_json_is_refused_with_the_position(stack: Stack, body: bytes, words: str) -> None:
    answer = stack.http.post("/jobs", content=body, headers={"Content-Type": "application/json"})
    document = problem(answer, 400, "malformed-body")
    assert words in document["detail"]


@pytest.mark.parametrize(
    "media_type", ["text/plain", "application/x-www-form-urlencoded", "application/jsonp", ""]
)
def test_another_media_type_is_refused(stack: Stack, media_type: str) -> None:
    headers = {"Content-Type": media_type} if media_type else {}
    answer = stack.http.post("/jobs", content=b'{"kind":"train","environment":"ant"}', headers=headers)
    problem(answer, 415, "unsupported-media-type")


def _pieces(size: int) -> Iterator[bytes]:
    for _ in range(size // 2**16):
        yield b" " * 2**16


@pytest.mark.parametrize("is_chunked", [False, True])
def test_a_body_over_a_mebibyte_is_refused(stack: Stack, is_chunked: bool) -> None:
    body = _pieces(2**20 + 2**16) if is_chunked else b" " * (2**20 + 1)
    answer = stack.http.post("/jobs", content=body, headers={"Content-Type": "application/json"})
    document = problem(answer, 413, "body-too-large")
    assert document["limit_bytes"] == 2**20


def test_a_body_that_announces_a_terabyte_is_refused_unread(stack: Stack) -> None:
    # Nothing but the head is ever sent: an answer can only come if nobody waits for the body.
    fields = f"Host: localhost\r\nContent-Type: application/json\r\nContent-Length: {2**40}\r\n"
    with socket.create_connection(("127.0.0.1", stack.port), timeout=10) as connection:
        connection.sendall(f"POST /jobs HTTP/1.1\r\n{fields}\r\n".encode())
        assert connection.recv(1000).startswith(b"HTTP/1.1 413 ")


@pytest.mark.parametrize("key", ["", "x" * 256, "töpfe".encode(), b"tab\there"])
def test_an_idempotency_key_must_be_short_and_printable(stack: Stack, key: str | bytes) -> None:
    document = problem(
        stack.http.post("/jobs", json=MINIMAL, headers={"Idempotency-Key": key}), 422, "invalid-request"
    )
    assert pointers(document) == ["/Idempotency-Key"]


def test_a_page_of_another_site_may_not_submit_or_cancel(stack: Stack) -> None:
    headers = {"Sec-Fetch-Site": "cross-site"}
    problem(stack.http.post("/jobs", json=MINIMAL, headers=headers), 403, "cross-site-request")
    problem(stack.http.post(f"/jobs/{NO_JOB}/cancel", headers=headers), 403, "cross-site-request")
