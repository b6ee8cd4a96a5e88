"""Where joints put a body, where one can work it out by hand."""

import jax.numpy as jnp
import mujoco
import pytest

from core.environments.body_position import body_position
from core.physics.engine import PhysicsState


def read(body: str, qpos: list[float], name: str = "b") -> dict[str, float]:
    """The position read of the body of that name under these joint positions."""
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><compiler angle='degree'/><worldbody>{body}</worldbody></mujoco>"
    )
    nothing, zero = jnp.zeros(0), jnp.zeros(())
    physics = PhysicsState(jnp.array(qpos), nothing, nothing, nothing, zero, {}, {})
    found = body_position(model, model.body(name).id)(physics)
    return {name: float(value) for name, value in found.items()}


def test_slides_move_a_body_from_where_it_was_put_until_a_hinge_turns_it() -> None:
    slides = "<joint type='slide' axis='1 0 0'/><joint type='slide' axis='0 0 1' ref='0.5'/>"
    # (2 + 1, 0, 3 + 1.5 - 0.5) is a 3-4-5; the hinge turns the body about itself.
    planar = f"<body name='b' pos='2 0 3'>{slides}<joint axis='0 1 0'/><geom size='1'/></body>"
    expected = {"height": pytest.approx(4.0), "distance_from_origin": pytest.approx(5.0)}
    assert read(planar, [1.0, 1.5, 0.7]) == expected
    # A quarter turn about y takes the slide along x down.
    turned = (
        "<body name='b' pos='0 0 3' euler='0 90 0'><joint type='slide' axis='1 0 0'/><geom size='1'/></body>"
    )
    expected = {"height": pytest.approx(2.0), "distance_from_origin": pytest.approx(2.0)}
    assert read(turned, [1.0]) == expected


def test_of_a_free_body_the_joint_says_it() -> None:
    free = "<body name='b' pos='9 9 9'><freejoint/><geom size='1'/></body>"
    assert read(free, [1.0, 2.0, 2.0, 1, 0, 0, 0]) == {"height": 2.0, "distance_from_origin": 3.0}


@pytest.mark.parametrize(
    "body",
    [
        "<body name='b'><geom size='1'/></body>",
        "<body name='b'><joint axis='0 1 0'/><geom size='1'/></body>",
        "<body name='b'><joint axis='0 1 0'/><joint type='slide'/><geom size='1'/></body>",
        "<body name='b'><joint type='slide'/><joint axis='0 1 0' pos='1 0 0'/><geom size='1'/></body>",
        "<body><joint/><geom size='1'/><body name='b'><joint type='slide'/><geom size='1'/></body></body>",
    ],
)
def test_where_its_own_joints_do_not_tell_nothing_is_said(body: str) -> None:
    assert read(body, [0.0, 0.0]) == {}
