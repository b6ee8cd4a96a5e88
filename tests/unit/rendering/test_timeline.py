import mujoco
import numpy as np
import pytest

from core.rendering.timeline import EpisodeMotion, calmed, interpolate, shots, smoothed

FREE_BODY = """
<mujoco><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>
"""


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(FREE_BODY)


def motion(*x: float, dt: float = 0.5) -> EpisodeMotion:
    qpos = np.zeros((len(x), 7))
    qpos[:, 0], qpos[:, 3] = x, 1.0
    return EpisodeMotion(dt * np.arange(len(x)), qpos)


def test_frames_are_spread_over_the_real_time_of_the_episode(model: mujoco.MjModel) -> None:
    # 2 m in 1 s, at 4 frames a second: 0, 0.25, 0.5, 0.75 s.
    [shot] = shots(model, [motion(0.0, 1.0, 2.0)], fps=4, seconds=10.0)
    np.testing.assert_allclose(shot.qpos[:, 0], [0.0, 0.5, 1.0, 1.5])


def test_a_video_is_no_longer_than_asked_for(model: mujoco.MjModel) -> None:
    [shot] = shots(model, [motion(0.0, 1.0, 2.0)], fps=4, seconds=0.5)
    assert len(shot.qpos) == 2


def test_between_two_episodes_the_picture_cuts(model: mujoco.MjModel) -> None:
    # The first ends at x = 1 after 0.5 s, the second begins at x = 100: nothing lies between them.
    first, second = shots(model, [motion(0.0, 1.0), motion(100.0, 101.0)], fps=8, seconds=10.0)
    np.testing.assert_allclose(first.qpos[:, 0], [0.0, 0.25, 0.5, 0.75])
    np.testing.assert_allclose(second.qpos[:, 0], [100.0, 100.25, 100.5, 100.75])


def test_an_episode_without_steps_still_gives_one_frame(model: mujoco.MjModel) -> None:
    [shot] = shots(model, [motion(3.0)], fps=30, seconds=10.0)
    np.testing.assert_allclose(shot.qpos[:, 0], [3.0])


def test_rotations_take_the_shortest_arc(model: mujoco.MjModel) -> None:
    # A quarter turn about z, half way: an eighth turn, cos(π/8) and sin(π/8); the end is stored with
    # the opposite sign, which is the same rotation.
    qpos = np.zeros((2, 7))
    qpos[0, 3] = 1.0
    qpos[1, 3:] = [-np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)]
    half_way = interpolate(model, EpisodeMotion(np.array([0.0, 1.0]), qpos), np.array([0.5]))
    np.testing.assert_allclose(half_way[0, 3:], [np.cos(np.pi / 8), 0.0, 0.0, np.sin(np.pi / 8)], atol=1e-12)


def test_a_steady_walk_is_followed_without_lag() -> None:
    steady = np.outer(np.arange(60) / 30.0, [3.0, 0.0, 0.0])
    np.testing.assert_allclose(smoothed(steady, fps=30, spread_s=0.4), steady, atol=1e-9)


def test_a_mean_of_what_came_before_keeps_what_is_steady_and_calms_what_swings() -> None:
    time = 0.02 * np.arange(501)
    speed = np.stack([np.full(501, 0.5), 0.5 + np.sin(2 * np.pi * 2.5 * time)], axis=1)
    calm = calmed(time, speed, spread_s=0.3)
    np.testing.assert_allclose(calm[:, 0], 0.5)
    # A filter of first order divides a swing of 2.5 Hz by 2π · 2.5 Hz · 0.3 s = 4.7.
    assert np.abs(calm[300:, 1] - 0.5).max() < 1 / 4.5
    # After one time constant, 1 - 1/e of a change.
    changed = calmed(time, (time > 0).astype(float), spread_s=0.3)
    np.testing.assert_allclose(changed[15], 1 - np.exp(-1))


def test_the_steps_of_a_walk_do_not_shake_the_camera() -> None:
    # 3 Hz bouncing by ±0.1 m: a Gaussian of 0.4 s leaves exp(-(2π·3·0.4)²/2) < 1e-12 of it, were its
    # window not cut off at three deviations.
    bouncing = 0.1 * np.sin(2 * np.pi * 3 * np.arange(150) / 30.0)[:, None]
    middle = smoothed(np.tile(bouncing, (1, 3)), fps=30, spread_s=0.4)[50:100]
    assert np.abs(middle).max() < 0.002


@pytest.mark.parametrize("length", [1, 2, 3, 10])
def test_short_paths_keep_their_length(length: int) -> None:
    assert smoothed(np.zeros((length, 3)), fps=30, spread_s=0.4).shape == (length, 3)
