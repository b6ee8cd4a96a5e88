"""Which body is the root, and what parts without names are called."""

from pathlib import Path

import mujoco
import pytest

from core.environments.mjcf.model import read
from core.environments.task_model import compiled
from core.environments.terms.describe import can_go_forward, inventory, root_of

BALL = '<body name="ball" pos="3 0 1"><freejoint/><geom size=".1"/></body>'
CRANE = (
    '<body name="crane" pos="0 3 0"><body name="boom"><joint axis="0 0 1"/><geom size=".1"/></body></body>'
)
TARGET = '<body name="target" mocap="true"><geom size=".1" contype="0" conaffinity="0"/></body>'
DOG = '<body name="dog" pos="0 0 1"><freejoint/><geom size=".1"/>{}</body>'
LEG = '<body name="leg"><joint name="hip" axis="0 1 0"/><geom size=".05"/><site name="toe"/></body>'
ARM = '<body name="base"><geom size=".1"/>{}</body>'
FINGER = (
    '<body name="link"><joint name="hip" axis="0 1 0"/><geom size=".1" pos="1 0 0"/>'
    '<body name="finger"><joint name="grip" type="slide"/><geom size=".01"/><site name="toe"/></body></body>'
)
CART = '<body name="rail"><body name="cart"><joint name="hip" type="slide"/><geom size=".1"/></body></body>'
MOTOR = '<motor joint="hip"/>'


def model(world: str, actuators: str = MOTOR, more: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{world}</worldbody>{more}<actuator>{actuators}</actuator></mujoco>"
    )


@pytest.mark.parametrize(
    ("world", "root"),
    [
        (DOG.format(LEG), "dog"),
        (BALL + DOG.format(LEG), "dog"),
        (CRANE + DOG.format(LEG), "dog"),
        (TARGET + DOG.format(LEG), "dog"),
        (CRANE + TARGET + ARM.format(LEG), "base"),
        # A ball that lies before an arm is not what the arm's job is about.
        (BALL + ARM.format(LEG), "base"),
        # A finger slides, but it hangs on the arm.
        (ARM.format(FINGER), "base"),
        (BALL + CART, "cart"),
    ],
)
def test_the_root_belongs_to_the_first_tree_with_actuators(world: str, root: str) -> None:
    found = model(world)
    assert found.body(root_of(found)).name == inventory(found).root == root


@pytest.mark.parametrize(
    ("actuators", "more"),
    [
        ('<motor jointinparent="hip"/>', ""),
        (
            '<motor tendon="pull"/>',
            '<tendon><fixed name="pull"><joint joint="hip" coef="1"/></fixed></tendon>',
        ),
        (
            '<motor tendon="pull"/>',
            '<tendon><spatial name="pull"><site site="out"/><site site="toe"/></spatial></tendon>',
        ),
        ('<general site="toe" gear="0 0 1 0 0 0"/>', ""),
        ('<adhesion body="leg" ctrlrange="0 1"/>', ""),
    ],
)
def test_an_actuator_of_any_kind_tells_which_tree_it_is(actuators: str, more: str) -> None:
    found = model('<site name="out"/>' + BALL + DOG.format(LEG), actuators, more)
    assert found.body(root_of(found)).name == "dog"


def test_a_body_that_turns_about_its_own_origin_cannot_go_forward() -> None:
    turning = model(LEG)
    assert not can_go_forward(turning, root_of(turning))
    assert not can_go_forward(model(ARM.format(LEG)), 1)
    dog = model(DOG.format(LEG))
    assert can_go_forward(dog, root_of(dog))


def test_parts_without_names_are_called_by_their_body(tmp_path: Path) -> None:
    xml = (
        '<mujoco><worldbody><geom size="1 1 1" type="plane"/><body name="dog"><freejoint/><geom size=".1"/>'
        '<geom size=".2"/><body><joint axis="0 1 0"/><joint axis="1 0 0"/><geom name="dog geom 2" size=".1"/>'
        '</body></body></worldbody><actuator><motor joint="body hinge"/></actuator></mujoco>'
    )
    (tmp_path / "model").write_text(xml.replace('<actuator><motor joint="body hinge"/></actuator>', ""))
    with read(tmp_path / "model") as (spec, _):
        found = inventory(compiled(spec))
    assert found.bodies == ["world", "dog", "body"]
    assert [joint.name for joint in found.joints] == ["dog free", "body hinge", "body hinge 2"]
    assert found.geoms == ["world geom", "dog geom", "dog geom 3", "dog geom 2"]


def test_a_body_that_is_not_symmetric_says_that_clips_of_it_cannot_be_mirrored() -> None:
    aside = DOG.format(LEG.replace('name="leg"', 'name="leg" pos="0.1 0.3 0.2"').replace("0 1 0", "1 2 3"))
    assert inventory(model(DOG.format(LEG))).no_mirror is None
    assert "no joint is the mirror image of `hip`" in (inventory(model(aside)).no_mirror or "")
