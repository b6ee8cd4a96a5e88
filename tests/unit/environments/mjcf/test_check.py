"""What a job asks for and its model has not got, as the API sees it: from the inventory alone."""

import re
import time
from pathlib import Path
from typing import Any

import mujoco
import pytest

from core.environments import catalog
from core.environments.mjcf.check import problems
from core.environments.mjcf.info import MjcfOptions
from core.environments.terms.describe import inventory
from core.environments.terms.inventory import Inventory
from core.errors import Rejected
from core.jobs.spec import JOB_SPEC, TrainSpec
from tests.models import identity
from tests.unit.environments.mjcf.probe import MODEL, XML

ROOT = Path(__file__).parents[4]
PROBE = inventory(mujoco.MjModel.from_xml_string(XML.decode()))
BOLTED = inventory(
    mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="a"><joint axis="0 1 0"/><geom size="1"/></body></worldbody></mujoco>'
    )
)
STAND = inventory(
    mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="stand"><geom size="1"/><body name="arm"><joint axis="0 1 0"/>'
        '<geom size="1"/></body></body></worldbody></mujoco>'
    )
)


def parsed(**given: Any) -> MjcfOptions:
    options = catalog.parse_options(catalog.find("mjcf"), {"model": MODEL, **given})
    assert isinstance(options, MjcfOptions)
    return options


def test_an_inventory_names_what_is_there() -> None:
    assert (PROBE.root, PROBE.has_free_joint, PROBE.travels) == ("ball", True, True)
    assert (PROBE.bodies, PROBE.geoms) == (["world", "ball", "arm"], ["floor", "sphere", "rod"])
    assert [(joint.name, joint.type, joint.range) for joint in PROBE.joints] == [
        ("root", "free", None),
        ("elbow", "hinge", (pytest.approx(-1.0), pytest.approx(1.0))),
    ]
    assert [(one.name, one.control_range) for one in PROBE.actuators] == [("elbow", (-0.5, 1.5))]
    assert [(one.name, one.type, one.size) for one in PROBE.sensors] == [
        ("speed", "velocimeter", 3),
        ("angle", "jointpos", 1),
    ]
    assert (PROBE.cameras, PROBE.keyframes) == (["above"], ["raised"])
    assert (PROBE.sizes.nq, PROBE.sizes.nv, PROBE.sizes.nu) == (8, 7, 1)
    assert (PROBE.initial_height, PROBE.mass_kg) == (pytest.approx(0.5), pytest.approx(1.1))
    assert PROBE.num_pairs == 1  # the ball and the floor
    assert (BOLTED.root, BOLTED.has_free_joint, BOLTED.travels) == ("a", False, False)


@pytest.mark.parametrize(
    ("given", "model", "pointer", "sentence"),
    [
        ({"root": "bal"}, PROBE, "/root", "no body 'bal'; did you mean 'ball'?"),
        ({"reward": [{"kind": "upright", "body": "x"}]}, PROBE, "/reward/0/body", "it has world, ball, arm."),
        (
            {"reward": [{"kind": "alive"}, {"kind": "distance", "target": "harm"}]},
            PROBE,
            "/reward/1/target",
            "did you mean 'arm'?",
        ),
        (
            {"termination": [{"kind": "contact", "geoms": ["rod", "spere"]}]},
            PROBE,
            "/termination/0/geoms/1",
            "did you mean 'sphere'?",
        ),
        (
            {"reward": [{"kind": "contact", "geoms": ["rod"], "against": "flor"}]},
            PROBE,
            "/reward/0/against",
            "did you mean 'floor'?",
        ),
        (
            {"reward": [{"kind": "joint_limits", "joints": ["root"]}]},
            PROBE,
            "/reward/0/joints/0",
            "no joint with a range 'root'; it has elbow.",
        ),
        (
            {"observation": [{"kind": "sensors", "names": ["sped"]}]},
            PROBE,
            "/observation/0/names/0",
            "did you mean 'speed'?",
        ),
        ({"reward": [{"kind": "joint_limits"}]}, BOLTED, "/reward/0", "joints has a range"),
        (
            {"termination": [{"kind": "contact", "geoms": ["rod"], "against": "rod"}]},
            PROBE,
            "/termination/0/against",
            "'rod' never touches itself",
        ),
        ({"observation": [{"kind": "act"}]}, PROBE, "/observation/0", "has a state"),
        ({"observation": [{"kind": "sensors"}]}, BOLTED, "/observation/0", "has no sensors"),
        (
            {"observation": [{"kind": "qpos", "root_position": "height"}]},
            BOLTED,
            "/observation/0/root_position",
            "has no free joint",
        ),
        (
            {"root": "arm", "observation": [{"kind": "qpos", "root_position": "all"}]},
            PROBE,
            "/observation/0/root_position",
            "'arm' has no free joint",
        ),
        ({"reward": [{"kind": "forward_velocity"}]}, STAND, "/reward/0/body", "'stand' has no joint"),
        (
            {"reward": [{"kind": "velocity_tracking", "velocity": [1, 0], "body": "world"}]},
            PROBE,
            "/reward/0/body",
            "never moves",
        ),
        ({"reward": [{"kind": "distance", "target": "ball"}]}, PROBE, "/reward/0/target", "to itself"),
        ({"reset": {"qpos": [0.0] * 8}}, PROBE, "/reset/qpos/3", "of the joint 'root' is not a quaternion"),
        ({"reset": {"qpos": [0.0]}}, PROBE, "/reset/qpos", "8 positions (nq); 1 were given"),
        ({"reset": {"keyframe": "low"}}, PROBE, "/reset/keyframe", "it has 1, among them raised"),
        ({"reset": {"keyframe": 1}}, PROBE, "/reset/keyframe", "no keyframe 1"),
        ({"reset": {"keyframe": 0}}, BOLTED, "/reset/keyframe", "it has none"),
    ],
)
def test_what_the_model_has_not_got_is_named_with_what_it_has(
    given: dict[str, Any], model: Inventory, pointer: str, sentence: str
) -> None:
    (problem,) = problems(parsed(**given), model)
    assert problem.pointer == f"/environment/options{pointer}"
    assert sentence in problem.detail


def test_what_the_model_has_is_no_problem() -> None:
    terms = {
        "reward": [{"kind": "contact", "geoms": ["rod"], "against": "floor"}, {"kind": "joint_limits"}],
        "observation": [{"kind": "qpos", "root_position": "none"}, {"kind": "sensors"}],
        "reset": {"keyframe": 0},
    }
    assert problems(parsed(**terms), PROBE) == []
    of_the_arm = {"kind": "forward_velocity", "of": "centre_of_mass"}
    assert problems(parsed(reward=[of_the_arm, {**of_the_arm, "body": "arm", "name": "b"}]), STAND) == []
    assert problems(parsed(reset={"qpos": [0, 0, 1, 1, 0, 0, 0, 0]}), PROBE) == []
    assert problems(parsed(), BOLTED) == []


def test_the_job_of_the_page_fits_the_model_of_the_examples() -> None:
    file = ROOT / "examples" / "quadruped.xml"
    page = (ROOT / "docs" / "environments" / "mjcf.md").read_text()
    (job,) = re.findall(r"-d '(\{[^']*" + identity(file.read_bytes()) + r"[^']*\})'", page)
    spec = JOB_SPEC.validate_json(job)
    assert isinstance(spec, TrainSpec)
    model = inventory(mujoco.MjModel.from_xml_path(str(file)))
    assert problems(parsed(**spec.environment.options), model) == []
    assert spec.video.camera in model.cameras


@pytest.mark.parametrize(
    ("given", "pointer", "sentence"),
    [
        ({"model": "ant"}, "/model", "match"),
        ({"reward": []}, "/reward", "at least 1"),
        ({"reward": [{"kind": "forward_velocit"}]}, "/reward/0", "forward_velocity"),
        ({"reward": [{"kind": "alive", "weigt": 1}]}, "/reward/0/weigt", "not permitted"),
        ({"reward": [{"kind": "alive"}, {"kind": "alive"}]}, "", "two reward terms are called reward_alive"),
        ({"reward": [{"kind": "distance"}]}, "/reward/0", "either point or target"),
        ({"reward": [{"kind": "upright", "axis": [0, 0, 0]}]}, "/reward/0/axis", "axis: must not be"),
        ({"reward": [{"kind": "forward_velocity", "direction": [0, 0, 0]}]}, "/reward/0/direction", "0, 0"),
        ({"termination": [{"kind": "height_range"}]}, "/termination/0/range", "required"),
        ({"termination": [{"kind": "height_range", "range": [2, 1]}]}, "/termination/0/range", "low < high"),
        ({"observation": [{}]}, "/observation/0", "kind"),
        ({"reset": {"keyframe": 0, "qpos": [0.0]}}, "/reset", "either keyframe or qpos"),
    ],
)
def test_terms_that_do_not_go_together_are_refused_with_their_place(
    given: dict[str, Any], pointer: str, sentence: str
) -> None:
    with pytest.raises(Rejected, match=sentence) as refusal:
        parsed(**given)
    assert [problem.pointer for problem in refusal.value.problems] == [f"/environment/options{pointer}"]


def test_thousands_of_wrong_names_against_thousands_of_parts_take_no_second() -> None:
    """H1: each was compared with every part; a request of 1 MiB took more than an hour."""
    many = PROBE.model_copy(update={"bodies": [f"limb_{number:05}" for number in range(40_000)]})
    names = [f"{number}_bmil" for number in range(1000)]
    options = parsed(observation=[{"kind": kind, "bodies": names} for kind in ("cvel", "cinert") * 32])
    before = time.thread_time()
    found = problems(options, many)
    assert time.thread_time() - before < 2
    assert len(found) == 50
    assert found[0].pointer == "/environment/options/observation/0/bodies/0"
    assert "did you mean" in found[0].detail or "it has limb_00000" in found[0].detail


def test_an_observation_has_a_bound_which_is_known_before_its_numbers_are_named() -> None:
    """H1's kind: 64 terms of 1,000 bodies were millions of names."""
    options = parsed(observation=[{"kind": "cinert", "bodies": ["arm"] * 1000}] * 64)
    assert [(one.pointer, one.detail) for one in problems(options, PROBE)] == [
        (
            "/environment/options/observation",
            "The observation has 640,000 numbers; at most 50,000 are allowed.",
        )
    ]
