"""What is added to a scene to be seen: a floor below what hangs in the air, a target that stands out."""

import mujoco
import numpy as np
import pytest

from core.physics.model import brax_model
from core.rendering import floor
from core.rendering.scene import CameraView, Quality, following_view, prepare

# An arm that turns about a horizontal axis at 2 m; its tip is 0.5 + 0.1 m away from there.
ARM = """<mujoco><worldbody>{world}
  <body name="arm" pos="0 0 2">{joint}<geom type="capsule" size="0.1" fromto="0 0 0 0.5 0 0"/></body>
</worldbody></mujoco>"""
HINGE = '<joint axis="0 1 0"/>'


def view_of(model: mujoco.MjModel, body: str) -> CameraView:
    return following_view(model, model.qpos0, model.body(body).id)


@pytest.mark.parametrize(
    ("world", "joint", "height"),
    [
        # The geom's bounding sphere of 0.35 m about its middle, 0.25 m away: 2 - 1.05 * 0.6.
        ("", HINGE, 1.37),
        ('<geom type="plane" size="1 1 1"/>', HINGE, None),
        ("", "<freejoint/>", None),
        ("", '<joint type="slide" axis="0 0 1"/>', None),
    ],
)
def test_what_cannot_fall_is_shown_over_a_floor_out_of_its_reach(
    world: str, joint: str, height: float | None
) -> None:
    model = mujoco.MjModel.from_xml_string(ARM.format(world=world, joint=joint))
    assert view_of(model, "arm").floor == (None if height is None else pytest.approx(height))


def test_the_tiles_stay_where_they_are_while_the_body_moves_over_them() -> None:
    model = brax_model("inverted_pendulum")
    height = view_of(model, "cart").floor
    assert height is not None

    def tiles(x: float) -> dict[tuple[float, float], float]:
        scene = mujoco.MjvScene(model, 1000)
        floor.lay(scene, height, np.array([x, 0.0, 0.0]), radius=1.0)
        _, *found = (scene.geoms[number] for number in range(scene.ngeom))
        assert all(geom.pos[2] < -0.1 for geom in found)  # The cart's lowest point.
        return {(round(float(g.pos[0]), 3), round(float(g.pos[1]), 3)): float(g.rgba[0]) for g in found}

    here, there = tiles(0.0), tiles(3.0)
    both = here.keys() & there.keys()
    # Tiles of 0.6 m go along by pairs, 1.2 m: at 3 m four of twenty columns are others.
    assert len(both) == 16 * 20
    assert all(here[place] == there[place] for place in both)
    assert len(set(here.values())) == 2


def test_a_target_that_looks_like_the_arm_gets_a_colour_and_others_keep_theirs() -> None:
    model, painted = brax_model("reacher"), brax_model("reacher")
    geom = model.geom("target").id
    painted.geom_rgba[geom] = own = [0.1, 0.9, 0.1, 1.0]
    before = model.geom_rgba.copy()
    view = view_of(model, "body0")
    for one in (model, painted):
        prepare(one, view, Quality(samples=0, shadow_pixels=64), width=64, height=48)
    assert np.ptp(model.geom_rgba[geom] - before[geom]) > 0.3
    assert model.geom_size[geom, 0] > 0.009
    np.testing.assert_array_equal(model.geom_rgba[model.geom("link0").id], before[model.geom("link0").id])
    np.testing.assert_allclose(painted.geom_rgba[geom], own, rtol=1e-6)
    assert painted.geom_size[geom, 0] == pytest.approx(0.009)
    # White, it was whiter than everything that is on it.
    assert model.geom_rgba[model.geom("ground").id, :3] == pytest.approx(floor.LIGHT)


FLOORS = """<mujoco>
  <asset>
    <texture name="checker" type="2d" builtin="checker" width="8" height="8" rgb1="0 0 0" rgb2="1 1 1"/>
    <material name="stretched" texture="checker" texrepeat="60 30"/>
    <material name="uniform" texture="checker" texrepeat="60 30" texuniform="true"/>
    <material name="picture" texture="checker"/>
    <material name="shared" texture="checker" texrepeat="60 30"/>
  </asset>
  <worldbody>
    <geom name="plain" type="plane" size="40 20 1"/>
    <geom name="stretched" type="plane" size="40 20 1" material="stretched"/>
    <geom name="uniform" type="plane" size="40 20 1" material="uniform"/>
    <geom name="picture" type="plane" size="40 20 1" material="picture"/>
    <geom name="shared" type="plane" size="40 20 1" material="shared"/>
    <geom name="block" type="box" size="1 1 1" material="shared"/>
    <geom name="wall" type="plane" size="40 20 1" euler="90 0 0"/>
    <geom name="mark" type="plane" size="40 20 1" contype="0" conaffinity="0"/>
  </worldbody>
</mujoco>"""


def test_a_floor_that_holds_a_body_is_drawn_without_an_end_and_its_tiles_stay_as_large() -> None:
    model = mujoco.MjModel.from_xml_string(FLOORS)
    floor.without_end(model)
    names = [model.geom(number).name for number in range(model.ngeom)]
    endless = [name for name in names if (model.geom(name).size[:2] == 0).all()]
    assert endless == ["plain", "stretched", "uniform"]
    # 60 over 80 m, and 30 over 40 m, are 1.5 over 2 m.
    assert model.mat("stretched").texrepeat.tolist() == [1.5, 1.5]
    assert model.mat("uniform").texrepeat.tolist() == [60, 30]
    assert model.mat("shared").texrepeat.tolist() == [60, 30]
