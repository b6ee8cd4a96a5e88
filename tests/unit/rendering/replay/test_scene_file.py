"""The geometry that a browser gets, read back by another program."""

import io
from typing import Any

import numpy as np
import pytest
import trimesh

from core.rendering.replay.replay import replay_of, scene_of
from core.rendering.replay.replay_file import read_replay
from core.rendering.replay.skins import heaviest
from tests.unit.rendering.replay.models import ARM, SHAPES, model_of, rolling

REST = np.array([0.0, 0, 3, 1, 0, 0, 0])


@pytest.fixture(scope="module")
def scene() -> Any:
    content = scene_of(model_of(SHAPES), REST, 1)
    return trimesh.load(io.BytesIO(content), file_type="glb")


def part(scene: Any, name: str) -> Any:
    """A geom's triangles where they stand, in MuJoCo's axes."""
    place, geometry = scene.graph[f"geom_{model_of(SHAPES).geom(name).id}"]
    mesh = scene.geometry[geometry].copy().apply_transform(place)
    mesh.vertices = mesh.vertices[:, [0, 2, 1]] * [1, -1, 1]
    return mesh


HALF: dict[str, tuple[float, float, float]] = {
    "sphere": (0.5, 0.5, 0.5),
    "capsule": (0.2, 0.2, 0.9),  # half its straight part, and a radius
    "cylinder": (0.3, 0.3, 0.4),
    "box": (0.1, 0.2, 0.3),
    "ellipsoid": (0.1, 0.2, 0.4),
    "plane": (4.0, 2.0, 0.0),
}


@pytest.mark.parametrize("name", HALF)
def test_a_geom_has_its_size(scene: Any, name: str) -> None:
    low, high = part(scene, name).bounds
    # A circle of twenty corners, of which four are on the axes, is as wide as the circle.
    np.testing.assert_allclose((high - low) / 2, HALF[name], rtol=1e-3, atol=1e-6)


# Volumes by geometry; polyhedra inside round shapes have some per cent less.
VOLUMES = {
    "sphere": 4 / 3 * np.pi * 0.5**3,
    "capsule": 4 / 3 * np.pi * 0.2**3 + np.pi * 0.2**2 * 1.4,
    "cylinder": np.pi * 0.3**2 * 0.8,
    "box": 0.2 * 0.4 * 0.6,
    "ellipsoid": 4 / 3 * np.pi * 0.1 * 0.2 * 0.4,
    "mesh": 1 / 6,
}


@pytest.mark.parametrize("name", VOLUMES)
def test_a_solid_geom_is_closed_and_its_triangles_look_outwards(scene: Any, name: str) -> None:
    mesh = part(scene, name)
    corners = mesh.vertices[mesh.faces]
    # The divergence theorem: a sixth of the sum of triple products, positive if all look outwards.
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert 0.94 * VOLUMES[name] < volume < 1.001 * VOLUMES[name]


def test_a_mesh_stands_where_mujoco_has_it(scene: Any) -> None:
    low, high = part(scene, "mesh").bounds
    # Its body is at (0, 0, 3); the mesh has no place of its own, so its corners are those of the file.
    np.testing.assert_allclose([low, high], [[0, 0, 3], [1, 1, 4]], atol=1e-5)


def test_a_hill_is_as_high_as_its_field(scene: Any) -> None:
    low, high = part(scene, "hill").bounds
    np.testing.assert_allclose([low, high], [[7, -2, 0], [11, 2, 1]], atol=1e-6)


def test_what_mujoco_does_not_draw_is_not_there(scene: Any) -> None:
    nodes = set(scene.graph.nodes_geometry)
    assert "site_0" in nodes
    assert not {f"geom_{model_of(SHAPES).geom('unseen').id}", "site_1"} & nodes


def test_a_floor_has_as_many_tiles_as_in_mujoco(scene: Any) -> None:
    # 3 repeats on 2 m each way from the corner, so 0.5 · 3 · 8 = 12 along and 6 across.
    uv = part(scene, "plane").visual.uv
    np.testing.assert_allclose(np.ptp(uv, axis=0), [12, 6], atol=1e-5)


def test_bodies_stand_at_their_places_and_the_world_is_turned_up(scene: Any) -> None:
    place, _ = scene.graph["body_1"]
    np.testing.assert_allclose(place[:3, 3], [0, 3, 0], atol=1e-6)  # MuJoCo's z is glTF's y.


def test_of_many_bones_the_heaviest_four_are_kept() -> None:
    joints, weights = heaviest(np.array([[0.1, 0.4, 0.05, 0.2, 0.25], [0.0, 0.0, 1.0, 0.0, 0.0]]))
    assert joints.tolist() == [[1, 4, 3, 0], [2, 0, 0, 0]]
    # 0.4 + 0.25 + 0.2 + 0.1 = 0.95
    np.testing.assert_allclose(weights[0] * 0.95, [0.4, 0.25, 0.2, 0.1], rtol=1e-6)
    assert weights[1].tolist() == [1, 0, 0, 0]


def test_a_replay_is_read_back_as_it_was_written() -> None:
    model, motion = model_of(ARM), rolling()
    rewards = [np.ones(40), np.full(40, 0.5)]
    content = replay_of(model, [motion, motion], rewards, [{"num_steps": 40}, {"num_steps": 40}], 2)
    header, [first, second] = read_replay(content)
    assert (header["bodies"], header["tracked_body"], header["target_body"]) == ([2, 3], 2, 1)
    assert [episode["num_steps"] for episode in header["episodes"]] == [40, 40]
    assert first["position"].shape == (41, 2, 3)
    assert (first["return"][-1], second["return"][-1]) == (40, 20)
    np.testing.assert_array_equal(first["rotation"], second["rotation"])
    # The episodes' numbers follow each other, at multiples of 8 bytes.
    one, two = header["episodes"]
    assert two["start"] == one["length"]
    assert all(place["start"] % 8 == 0 for place in one["arrays"].values())


def test_another_file_is_no_replay() -> None:
    with pytest.raises(ValueError, match="does not begin with GWREPLAY"):
        read_replay(b"PK\x03\x04")
