"""What a first job for a user's robot is made of."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import pytest

from core.environments.mjcf import check, edit_check
from core.environments.mjcf.edits import edit
from core.environments.mjcf.info import MjcfOptions
from core.environments.mjcf.model import name_parts, read
from core.environments.mjcf.recipe import NoRecipe, Recipe, recipe
from core.environments.task_model import compiled
from core.environments.terms.describe import inventory
from tests.unit.environments.mjcf.probe import MODEL

EXAMPLE = Path(__file__).parents[4] / "examples" / "quadruped.xml"
ROOT = '<freejoint/><geom type="box" size="0.2 0.1 0.05" mass="4"/>'


def leg(name: str, x: float, y: float, foot: str = '<geom name="{name}" size="0.02" pos="0 0 -0.3"/>') -> str:
    """A hip that swings forward, and 0.3 m below it a ball."""
    return (
        f'<body name="{name}_leg" pos="{x} {y} 0"><joint name="{name}_hip" axis="0 1 0" armature="0.01"/>'
        f'<geom size="0.01" mass="0.5" contype="0" conaffinity="0"/>{foot.format(name=name)}</body>'
    )


def robot(parts: Sequence[str], more: str = "", root: str = ROOT) -> mujoco.MjSpec:
    trunk = f'<body name="trunk" pos="0 0 1">{root}{"".join(parts)}</body>'
    xml = f"<mujoco><worldbody>{trunk}</worldbody>{more}</mujoco>"
    spec = mujoco.MjSpec.from_string(xml)
    name_parts(spec)
    return spec


def problems(made: Recipe, spec: mujoco.MjSpec) -> list[str]:
    """What a submission of it would be refused with."""
    options = MjcfOptions.model_validate({"model": MODEL, **made.options})
    before = inventory(compiled(spec.copy()))
    found = list(edit_check.problems(options.edits, before, ""))
    return [one.detail for one in found or check.problems(options, edit_check.edited(before, options.edits))]


def test_a_robot_with_servos_and_a_pose_needs_nothing_but_terms() -> None:
    with read(EXAMPLE) as (spec, _):
        made = recipe(spec)
        assert problems(made, spec) == []
    edits = made.options["edits"]
    # Around the root from its heading to the left, so that feet in turn are half a round apart.
    legs = ["front_left", "hind_left", "hind_right", "front_right"]
    assert [foot.removesuffix("_shank") for foot in edits["feet"]] == legs
    assert made.options["gait"]["offsets"] == [0.0, 0.5, 0.0, 0.5]
    assert len(edits["collide"]) == 4
    assert edits["pose"] == {"keyframe": "home"}
    assert "servos" not in edits
    assert made.notes == []


def test_servos_of_joints_without_motors_follow_from_the_mass_and_say_so() -> None:
    joint = '<joint name="elbow" axis="0 0 1" armature="0.02"/>'
    arm = f'<body name="arm">{joint}<geom size="0.01" mass="0.01"/></body>'
    spec = robot([leg("left", 0, 0.1), leg("right", 0, -0.1), arm])
    made = recipe(spec)
    assert problems(made, spec) == []
    legs, elbow = made.options["edits"]["servos"]
    # m g h = 5.0 kg · 9.81 m/s² · 0.32 m, on one leg of two, twice.
    assert legs["joints"] == ["left_hip", "right_hip"]
    assert legs["kp"] == pytest.approx(2 * 5.0 * 9.81 * 0.32, rel=0.05)
    # (2π · 2.5 Hz)² · 0.02 kg m²
    assert elbow == {"joints": ["elbow"], "kp": 4.9, "effort": 2.5}
    assert ["kp" in note for note in made.notes] == [True, False]
    assert "no keyframe" in made.notes[1]
    posture = next(term for term in made.options["reward"] if term["kind"] == "posture")
    # Two legs swing forward freely; what else there is keeps its place.
    assert posture["weights"] == {"left_hip": 0.0, "right_hip": 0.0, ".*": 1.0}
    changed = spec.copy()
    edit(changed, MjcfOptions.model_validate({"model": MODEL, **made.options}).edits)
    assert compiled(changed).nu == 3


def test_limbs_like_the_feet_are_feet_though_they_hang_in_the_air() -> None:
    places = {"fl": (0.2, 0.1), "fr": (0.2, -0.1), "hl": (-0.2, 0.1), "hr": (-0.2, -0.1)}
    home = '<keyframe><key name="home" qpos="0 0 1 1 0 0 0 1.5 1.5 0 0"/></keyframe>'
    motors = "".join(f'<motor joint="{name}_hip" ctrlrange="-9 9"/>' for name in places)
    spec = robot(
        [leg(name, *place) for name, place in places.items()], f"<actuator>{motors}</actuator>{home}"
    )
    made = recipe(spec)
    assert problems(made, spec) == []
    assert made.options["edits"]["collide"] == ["fl", "hl", "hr", "fr"]
    assert made.options["edits"]["servos"] == [{"joints": [".*"]}]
    [note] = made.notes
    assert note.startswith("In its pose fl_leg, fr_leg are not on the floor")


def test_a_foot_that_is_a_mesh_becomes_a_box() -> None:
    corners = "0 0 0  .1 0 0  0 .1 0  0 0 .1"
    foot = '<geom name="{name}" type="mesh" mesh="foot" pos="0 0 -0.3"/>'
    assets = f'<asset><mesh name="foot" vertex="{corners}"/></asset>'
    spec = robot([leg("left", 0, 0.1, foot), leg("right", 0, -0.1, foot)], assets)
    made = recipe(spec)
    assert problems(made, spec) == []
    assert made.options["edits"]["primitives"] == [{"geoms": ["left", "right"], "shape": "box"}]


@pytest.mark.parametrize(
    ("spec", "why"),
    [
        (lambda: robot([leg("left", 0, 0.1)], root=""), "no free joint"),
        (lambda: robot([leg("left", 0, 0.1)]), "1 of its bodies stand"),
        (lambda: robot([]), "no hinge"),
    ],
)
def test_what_cannot_walk_has_no_recipe(spec: Any, why: str) -> None:
    with pytest.raises(NoRecipe, match=why):
        recipe(spec())
