"""The arrows that are added to a scene; this needs no GL."""

import mujoco
import numpy as np

from core.rendering import arrows
from core.rendering.scene import following_view
from core.rendering.timeline import Floats
from tests.unit.rendering.replay.models import ARM, model_of

MODEL = model_of(ARM)
AT = np.array([0.0, 0.0, 0.3])
# The arm hangs from the ball's top: the ball is the highest, 0.3 m above its centre.
VIEW = following_view(MODEL, np.array([*AT, 1.0, 0, 0, 0, np.pi]), MODEL.body("ball").id)
BLUE, AMBER = (0.184, 0.435, 0.871), (0.941, 0.627, 0.125)
# Facing along y.
TURNED = np.array([0.0, -1, 0, 1, 0, 0, 0, 0, 1])


def drawn(velocities: Floats) -> dict[tuple[float, ...], Floats]:
    """The places of what is drawn, by colour."""
    scene = mujoco.MjvScene(MODEL, 1000)
    arrows.add(scene, VIEW, AT, TURNED, velocities)
    places: dict[tuple[float, ...], list[Floats]] = {}
    for geom in scene.geoms[: scene.ngeom]:
        colour = tuple(round(float(part), 3) for part in geom.rgba[:3])
        places.setdefault(colour, []).append(np.array(geom.pos, float))
    return {colour: np.array(each) for colour, each in places.items()}


def test_an_arrow_goes_where_the_body_is_told_to_go_and_another_where_it_goes() -> None:
    places = drawn(np.array([[0.5, 0.0, 0.0], [0.0, -1.0, 0.0]]))
    assert set(places) == {BLUE, AMBER}
    # Forward is along y, and the right along x.
    assert np.abs(places[BLUE][:, 0]).max() < 1e-6
    np.testing.assert_allclose(places[BLUE][:, 1].max(), 0.5 * VIEW.radius, rtol=0.05)
    np.testing.assert_allclose(places[AMBER][:, 0].max(), VIEW.radius, rtol=0.05)
    # Both above all of the body, one above the other.
    assert 0.6 < places[BLUE][0, 2] < places[AMBER][0, 2] < 0.6 + 0.5 * VIEW.radius


def test_a_turn_is_an_arc_from_where_the_body_faces() -> None:
    places = drawn(np.array([[0.0, 0.0, 1.5], [0.0, 0.0, -0.5]]))
    for colour, turn in ((BLUE, 1.5), (AMBER, -0.5)):
        from_y = np.arctan2(-places[colour][:, 0], places[colour][:, 1])
        np.testing.assert_allclose(from_y[np.abs(from_y).argmax()], turn, atol=0.05)
        np.testing.assert_allclose(np.hypot(*places[colour][:, :2].T), 0.55 * VIEW.radius, rtol=0.02)


def test_one_that_stands_has_none() -> None:
    assert drawn(np.zeros((2, 3))) == {}


def test_a_point_to_reach_is_a_ball_on_the_ground() -> None:
    scene = mujoco.MjvScene(MODEL, 10)
    arrows.mark(scene, VIEW, np.array([2.0, 1.0]))
    np.testing.assert_allclose(scene.geoms[0].pos, [2, 1, 0])
    assert scene.ngeom == 1
