"""Where episodes begin: ranges of the root and of joints, and bodies that have fallen, on the probe."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from core.environments.mjcf.check import problems
from tests.unit.environments.mjcf.probe import KEY, build
from tests.unit.environments.mjcf.test_check import BOLTED, PROBE, parsed

HALF = np.sqrt(0.5)


def starts(folder: Path, number: int = 300, **reset: Any) -> tuple[np.ndarray, np.ndarray]:
    """Positions [number, nq] and velocities [number, nv] of as many episodes."""
    still = {"position_noise": 0.0, "velocity_noise": 0.0}
    environment = build(folder, reset={"qpos": [0, 0, 0.5, 1, 0, 0, 0, 0.2], **still, **reset})
    physics = jax.jit(jax.vmap(environment.reset))(jax.random.split(KEY, number)).physics
    return np.asarray(physics.qpos), np.asarray(physics.qvel)


def test_a_root_begins_within_its_ranges(tmp_path: Path) -> None:
    pose = {"x": [1, 2], "y": [-0.5, 0.5], "yaw": [-np.pi, np.pi]}
    qpos, qvel = starts(tmp_path, pose=pose, velocity={"x": [0.2, 0.4], "yaw": [-1, 1]})
    for values, low, high in (
        (qpos[:, 0], 1, 2),
        (qpos[:, 1], -0.5, 0.5),
        (2 * np.arctan2(qpos[:, 6], qpos[:, 3]), -np.pi, np.pi),
        (qvel[:, 0], 0.2, 0.4),
        (qvel[:, 5], -1, 1),
    ):
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high
    assert (qpos[:, 2] == 0.5).all()
    assert not qpos[:, 4:6].any()
    assert qpos[:, 7] == pytest.approx(0.2)
    assert not qvel[:, [1, 2, 3, 4, 6]].any()


def test_turns_are_about_the_worlds_axes_and_yaw_comes_last(tmp_path: Path) -> None:
    quarter = [np.pi / 2, np.pi / 2]
    qpos, _ = starts(tmp_path, 1, pose={"roll": quarter, "yaw": quarter})
    # The body's y goes up by the roll, and the yaw leaves it there: (HALF, 0, 0, HALF) × (HALF, HALF, 0, 0).
    assert qpos[0, 3:7].tolist() == pytest.approx([0.5, 0.5, 0.5, 0.5], abs=1e-6)


def test_joints_begin_in_a_share_of_their_ranges(tmp_path: Path) -> None:
    qpos, _ = starts(tmp_path, joints=0.5)  # The elbow goes from −1 to 1 rad.
    assert -0.5 <= qpos[:, 7].min() < -0.45
    assert 0.45 < qpos[:, 7].max() <= 0.5


def test_a_share_of_the_bodies_has_fallen_anyhow(tmp_path: Path) -> None:
    qpos, _ = starts(tmp_path, 400, fallen={"share": 0.5, "joints": 0})
    stands = (qpos[:, 3:7] == [1, 0, 0, 0]).all(axis=1)
    assert 0.4 < stands.mean() < 0.6
    assert (qpos[stands, 2] == 0.5).all()
    # The ball's radius, as nothing else of it collides.
    assert qpos[~stands, 2] == pytest.approx(0.1)
    quaternions = qpos[~stands, 3:7]
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1, atol=1e-5)
    # Uniform over all rotations: the z axes' mean is 0, and the mean of each square is 1/3.
    w, x, y, z = quaternions.T
    up = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    assert abs(up.mean(axis=1)).max() < 0.15
    assert (up**2).mean(axis=1) == pytest.approx([1 / 3] * 3, abs=0.1)
    assert qpos[:, 7] == pytest.approx(0.2)


def test_a_body_upside_down_lies_on_its_back(tmp_path: Path) -> None:
    qpos, _ = starts(tmp_path, 50, fallen={"upside_down": True, "height": [0.3, 0.4]})
    w, x, y, z = qpos[:, 3:7].T
    assert 1 - 2 * (x * x + y * y) == pytest.approx(-1.0, abs=1e-5)
    headings = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    assert headings.std() > 1
    assert 0.3 <= qpos[:, 2].min() < qpos[:, 2].max() <= 0.4
    assert np.ptp(qpos[:, 7]) > 1


def test_what_cannot_be_moved_is_refused() -> None:
    found = problems(parsed(reset={"pose": {"yaw": [0, 1]}, "joints": 0.5}), BOLTED)
    assert [problem.pointer.removeprefix("/environment/options") for problem in found] == [
        "/reset/pose",
        "/reset/joints",
    ]
    assert problems(parsed(reset={"fallen": {}, "joints": 0.5}), PROBE) == []
