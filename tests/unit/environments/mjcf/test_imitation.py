"""Terms of a body that follows a reference, on the probe: each number can be worked out by hand."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.clips.archive import to_bytes
from core.clips.clip import Clip
from core.environments import catalog
from core.environments.environment import TRUNCATED
from core.environments.mjcf.check import problems
from core.environments.reference.playback import FRAME
from core.environments.rollout import cut, rollout, zero_policy
from core.environments.task import TaskEnv
from core.environments.terms.binding import bound
from core.environments.terms.step import Step
from core.environments.terms.vocabulary import AnyReward
from core.errors import JobFailed, Rejected
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from core.reasons import Reason
from tests.unit.environments.mjcf.probe import KEY, XML, options
from tests.unit.environments.mjcf.test_check import PROBE, parsed
from tests.unit.environments.mjcf.test_environment import NO_TORQUE

FILE = "sha256:" + "1" * 64
# The probe acts every 0.01 s. The clip's five frames are 0.02 s apart, so that nine rows come of them.
RATE, NUM_ROWS, DT = 50.0, 9, 0.01
ENGINES: tuple[EngineName, ...] = ("native", "compiled")
REWARDS = (
    "track_root_position",
    "track_root_orientation",
    "track_joints",
    "track_joint_velocities",
    "track_body_positions",
    "track_body_orientations",
    "track_body_velocities",
    "track_end_effectors",
)


def flight(speed: float = 1.0, joints: Sequence[str] = ("elbow",), name: str = "flight") -> Clip:
    """It flies along x at this speed in m/s, 0.5 m high, and bends its elbow by 0.5 rad/s."""
    times = np.arange(5) / RATE
    return Clip(
        name=name,
        rate=RATE,
        root_position=np.stack([speed * times, 0 * times, 0 * times + 0.5], 1),
        root_orientation=np.tile([1.0, 0, 0, 0], (5, 1)),
        joints=tuple(joints),
        joint_positions=0.5 * np.stack([times] * len(joints), 1),
    )


def without_joints() -> Clip:
    return replace(flight(), joints=(), joint_positions=np.zeros((5, 0)))


def follower(
    folder: Path, clips: Sequence[Clip] = (flight(),), reference: Any = None, **given: Any
) -> TaskEnv:
    """The probe that follows these clips."""
    file, model = folder / "clips.npz", folder / "model"
    engine: EngineName = given.pop("engine", "native")
    file.write_bytes(to_bytes(clips))
    model.write_bytes(given.pop("xml", XML))
    info = catalog.find("mjcf")
    following = {"clips": [{"file": FILE}], **(reference or {})}
    given = {"reward": [{"kind": "track_joints"}], **given}
    parsed = catalog.parse_options(info, options(reference=following, **given))
    made = catalog.make(info, parsed, engine_builder(engine), model, {FILE: file})
    assert isinstance(made, TaskEnv)
    return made


def all_terms() -> dict[str, Any]:
    return {
        "reward": [{"kind": kind} for kind in REWARDS],
        "observation": [
            {"kind": "reference", "show": ["root_position", "root_orientation", "joints", "bodies"]},
            {"kind": "qpos"},
        ],
        "termination": [{"kind": "far_from_reference", "joint_position": 1.0, "body_position": 1.0}],
    }


def values(environment: TaskEnv, qpos: Sequence[float], qvel: Sequence[float], row: int) -> dict[str, float]:
    """Each reward of the physics in this state beside this row, by JAX and by NumPy, which agree."""
    model, parts = environment.model, environment._parts
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    derived = {name: np.array(getattr(data, name)) for name in ("xpos", "xquat", "cvel", "subtree_com")}
    assert environment.playback is not None
    following = environment.playback.following(jnp.int32(row), jnp.int32(0))
    found: list[dict[str, float]] = []
    for xp in (np, jnp):
        arrays = {name: xp.asarray(value, xp.float32) for name, value in derived.items()}
        physics = SimpleNamespace(
            qpos=xp.asarray(data.qpos, xp.float32), qvel=xp.asarray(data.qvel, xp.float32), derived=arrays
        )
        told = jax.tree.map(lambda x, xp=xp: xp.asarray(x), following)
        step = Step(physics, physics, xp.zeros(1), xp.zeros(1), DT, xp, following=told)
        terms: list[AnyReward] = environment._options.reward or []
        found.append({term.kind: float(bound(term, parts).measure(step)) for term in terms})
    assert found[0] == pytest.approx(found[1], abs=1e-5)
    return found[1]


def test_an_episode_begins_exactly_where_the_clip_is(tmp_path: Path) -> None:
    environment = follower(tmp_path)
    for row in (0, 3, 7):
        state = environment.at_frame(jnp.int32(row)).reset(KEY)
        # Rows are 0.01 s apart: x = 1 m/s · t, the elbow 0.5 rad/s · t.
        qpos = np.array([0.01 * row, 0, 0.5, 1, 0, 0, 0, 0.005 * row], np.float32)
        np.testing.assert_allclose(state.physics.qpos, qpos, atol=1e-7)
        np.testing.assert_allclose(state.physics.qvel, [1, 0, 0, 0, 0, 0, 0.5], atol=1e-5)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_slow_servo_begins_without_a_pull(engine: EngineName, tmp_path: Path) -> None:
    motor = XML[XML.index(b"<motor") : XML.index(b"</actuator>")]
    servo = b"""<general name="elbow" joint="elbow" gear="2" dyntype="filter" dynprm="0.1" gainprm="3"
      biastype="affine" biasprm="0.3 -0.5 0" ctrllimited="true" ctrlrange="-0.095 1"/>"""
    environment = follower(tmp_path, xml=XML.replace(motor, servo), engine=engine)
    # Its force 3 a + 0.3 - 0.5 · 2 q is 0 for a = (q - 0.3) / 3, where q = 0.005 rad in each row; that of the
    # first row, -0.1, is beyond its range.
    for row, activation in ((0, -0.095), (6, -0.09), (8, (0.04 - 0.3) / 3)):
        state = environment.at_frame(jnp.int32(row)).reset(KEY)
        np.testing.assert_allclose(state.physics.act, [activation], atol=1e-6)


def test_what_follows_exactly_earns_all_of_every_term(tmp_path: Path) -> None:
    environment = follower(tmp_path, **all_terms())
    # Without gravity the ball flies on, and the arm's turn moves it little in 0.01 s.
    state = jax.jit(environment.step)(environment.at_frame(jnp.int32(2)).reset(KEY), NO_TORQUE)
    for kind in REWARDS:
        assert float(state.metrics[f"reward_{kind}"]) == pytest.approx(1.0, abs=1e-3), kind
    assert float(state.metrics["root_error"]) < 1e-3
    # From row 2 to the last one, 8, it is six steps.
    assert float(state.metrics["clip_followed"]) == pytest.approx(1 / 6)
    assert float(state.done) == 0.0


def test_compiled_earns_and_sees_what_native_does(tmp_path: Path) -> None:
    seen = [
        jax.jit(environment.step)(environment.at_frame(jnp.int32(2)).reset(KEY), jnp.array([0.5]))
        for environment in (follower(tmp_path, engine=engine, **all_terms()) for engine in ENGINES)
    ]
    np.testing.assert_allclose(seen[0].obs, seen[1].obs, atol=1e-4)
    for name, value in seen[0].metrics.items():
        assert float(value) == pytest.approx(float(seen[1].metrics[name]), abs=1e-4), name


def test_each_kernel_is_that_of_its_error(tmp_path: Path) -> None:
    environment = follower(tmp_path, **all_terms())
    # Beside row 4, x = 0.04 and the elbow at 0.02 rad: 0.3 m too high, turned by 0.4 rad about z, the elbow
    # 0.3 rad too far and 3 rad/s too slow.
    half = 0.2
    turned = [np.cos(half), 0, 0, np.sin(half)]
    found = values(environment, [0.04, 0, 0.8, *turned, 0.32], [1, 0, 0, 0, 0, 0, -2.5], 4)
    assert found["track_root_position"] == pytest.approx(np.exp(-1))
    assert found["track_root_orientation"] == pytest.approx(np.exp(-1), rel=1e-4)
    assert found["track_joints"] == pytest.approx(np.exp(-1), rel=1e-4)
    assert found["track_joint_velocities"] == pytest.approx(np.exp(-1), rel=1e-4)
    # Ball and arm have one origin, 0.3 m too high; the heading of the anchor, the ball, does not count.
    assert found["track_body_positions"] == pytest.approx(np.exp(-1), rel=1e-4)
    assert found["track_end_effectors"] == pytest.approx(np.exp(-(0.3**2) / 0.1**2), rel=1e-3)
    # The ball's turn is the heading's; the arm is 0.3 rad further.
    assert found["track_body_orientations"] == pytest.approx(np.exp(-(0.3**2 / 2) / 0.4**2), rel=1e-4)
    # v is right, and so is the ball's ω; the arm's is -2.5 rad/s about an axis that is turned by 0.4 rad from
    # that of the wanted 0.5 rad/s.
    off = 0.5**2 + 2.5**2 + 2 * 0.5 * 2.5 * np.cos(0.4)
    assert found["track_body_velocities"] == pytest.approx(0.5 + 0.5 * np.exp(-off / 2 / 3.14**2), rel=1e-4)


def test_the_way_ahead_is_seen_in_the_roots_frame(tmp_path: Path) -> None:
    show = ["root_position", "root_orientation", "joints", "bodies"]
    environment = follower(
        tmp_path,
        reference={"ahead": {"frames": 2, "every_s": 0.03}},
        observation=[{"kind": "reference", "show": show}],
        reset={"keyframe": "raised", "position_noise": 0.0, "velocity_noise": 0.0},
    )
    state = environment.at_frame(jnp.int32(4)).reset(KEY)
    quarter = state.physics.qpos.at[3:7].set(jnp.array([0.5**0.5, 0, 0, 0.5**0.5]))
    physics = replace(state.physics, qpos=quarter)
    step = Step(physics, physics, NO_TORQUE, NO_TORQUE, environment.dt, jnp)
    seen = environment._after(environment._with_reference(step, state.info), state.info).obs
    # One step ahead is row 5, and four rows ahead row 8: 0.01 and 0.04 m along the world's x, which is −y of
    # the root, turned by a quarter to the left. There x turns to −y, and y to x.
    assert seen[:6].tolist() == pytest.approx([0, -0.01, 0, 0, -0.04, 0], abs=1e-6)
    assert seen[6:12].tolist() == pytest.approx([0, -1, 0, 1, 0, 0], abs=1e-6)
    # Joints are less those of the pose, 0.5 rad: 0.025 and 0.04.
    assert seen[18:20].tolist() == pytest.approx([-0.475, -0.46], abs=1e-6)
    row = catalog.resolve("mjcf", options(reference={"clips": [{"file": FILE}]}))[0]
    assert row.chosen is not None
    assert len(seen) == 2 * (3 + 6 + 1 + 2 * 3)


def test_the_clips_end_cuts_off_and_is_no_failure(tmp_path: Path) -> None:
    environment = follower(tmp_path, **all_terms())
    step = jax.jit(environment.step)
    state = environment.at_frame(jnp.int32(6)).reset(KEY)
    ends: list[tuple[float, float, int]] = []
    for _ in range(2):
        state = step(state, NO_TORQUE)
        ends.append((float(state.done), float(state.info[TRUNCATED]), int(state.info[FRAME])))
    assert ends == [(0.0, 0.0, 7), (1.0, 1.0, 8)]


def test_what_is_lost_ends_as_a_failure_also_in_the_last_frame(tmp_path: Path) -> None:
    environment = follower(tmp_path, **all_terms())
    state = environment.at_frame(jnp.int32(7)).reset(KEY)
    lost = replace(state, physics=replace(state.physics, qpos=state.physics.qpos.at[2].set(0.9)))
    after = environment.step(lost, NO_TORQUE)
    assert (float(after.done), float(after.info[TRUNCATED])) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("bound_of", "qpos", "ends"),
    [
        ({"root_position": 0.2}, [0.29, 0, 0.5, 1, 0, 0, 0, 0.02], 1.0),
        ({"root_position": 0.3}, [0.29, 0, 0.5, 1, 0, 0, 0, 0.02], 0.0),
        ({"root_orientation": 0.3}, [0.04, 0, 0.5, np.cos(0.2), 0, 0, np.sin(0.2), 0.02], 1.0),
        ({"anchor_height": 0.2}, [0.04, 0, 0.75, 1, 0, 0, 0, 0.02], 1.0),
        ({"end_effector_height": 0.2}, [0.04, 0, 0.75, 1, 0, 0, 0, 0.02], 1.0),
        ({"joint_position": 0.2}, [0.04, 0, 0.5, 1, 0, 0, 0, 0.3], 1.0),
        ({"body_position": 0.2}, [5.0, 5.0, 0.5, 1, 0, 0, 0, 0.02], 0.0),
    ],
)
def test_each_bound_ends_by_its_own_error(
    tmp_path: Path, bound_of: dict[str, float], qpos: list[float], ends: float
) -> None:
    none = dict.fromkeys(("root_position", "root_orientation", "anchor_height", "end_effector_height"))
    environment = follower(tmp_path, termination=[{"kind": "far_from_reference", **none, **bound_of}])
    state = environment.at_frame(jnp.int32(3)).reset(KEY)
    moved = replace(state.physics, qpos=jnp.array(qpos, jnp.float32))
    assert float(environment.step(replace(state, physics=moved), NO_TORQUE).done) == ends


def test_clips_begin_as_often_as_their_weights_and_lengths_say(tmp_path: Path) -> None:
    named = [flight(name="a"), flight(2.0, name="b")]
    chosen = [{"file": FILE, "names": ["a"], "weight": 3.0}, {"file": FILE, "names": ["b"]}]
    environment = follower(tmp_path, named, reference={"clips": chosen, "sampling": {"kind": "uniform"}})
    state = jax.jit(jax.vmap(environment.reset))(jax.random.split(KEY, 400))
    rows = np.asarray(state.info[FRAME])
    assert set(rows) == {*range(8), *range(9, 17)}  # No clip's last row.
    assert np.mean(rows < NUM_ROWS) == pytest.approx(0.75, abs=0.06)


def test_a_clip_is_cut_and_sped_up_as_the_job_says(tmp_path: Path) -> None:
    chosen = [{"file": FILE, "from_s": 0.02, "to_s": 0.06, "speed": 2.0}]
    environment = follower(tmp_path, reference={"clips": chosen})
    assert environment.playback is not None
    frames = environment.playback.frames.frames
    # 0.04 s in half the time are three rows; it flies at 2 m/s from 0.02 m on.
    np.testing.assert_allclose(frames.qpos[:, 0], [0.02, 0.04, 0.06], atol=1e-6)
    np.testing.assert_allclose(frames.qvel[:, 0], 2.0, atol=1e-5)


def test_a_mirrored_clip_goes_to_the_other_side(tmp_path: Path) -> None:
    left = flight()
    left.root_position[:, 1] = left.root_position[:, 0]
    environment = follower(tmp_path, [left], reference={"clips": [{"file": FILE, "mirror": True}]})
    assert environment.playback is not None
    frames = environment.playback.frames.frames
    np.testing.assert_allclose(frames.qpos[:, 1], -frames.qpos[:, 0], atol=1e-6)
    np.testing.assert_allclose(frames.qvel[:, 1], -1.0, atol=1e-5)
    # The elbow turns about y, which a mirror leaves.
    np.testing.assert_allclose(frames.qpos[:, 7], 0.5 * DT * np.arange(NUM_ROWS), atol=1e-6)


@pytest.mark.parametrize(
    ("clips", "reference", "words"),
    [
        ([flight(joints=("elbow", "tail"))], {}, "is of another body: the model has no joint tail"),
        ([without_joints()], {}, "moves none of the body's joints"),
        (
            [flight()],
            {"clips": [{"file": FILE, "names": ["walk.*"]}]},
            "is called 'walk.*'; there are flight",
        ),
        ([flight()], {"clips": [{"file": FILE, "from_s": 3.0}]}, "fewer than two frames"),
        ([flight()], {"clips": [{"file": "sha256:" + "2" * 64}]}, "is missing"),
    ],
)
def test_clips_that_do_not_fit_are_refused_with_the_reason(
    tmp_path: Path, clips: list[Clip], reference: dict[str, Any], words: str
) -> None:
    with pytest.raises(JobFailed, match=words.replace("*", r"\*")) as failed:
        follower(tmp_path, clips, reference=reference)
    assert failed.value.reason == Reason.BAD_CLIPS


def test_more_frames_than_a_program_can_hold_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The probe has 8 positions and 7 velocities, and its two bodies 13 numbers each: 164 B a row.
    monkeypatch.setattr("core.environments.terms.reference._MOST_BYTES", 164 * NUM_ROWS)
    follower(tmp_path)
    with pytest.raises(JobFailed, match=r"18 frames .* has room for 9 .* cut them") as failed:
        follower(tmp_path, [flight(name="a"), flight(name="b")])
    assert failed.value.reason == Reason.BAD_CLIPS


def test_each_clip_has_a_name_of_its_own(tmp_path: Path) -> None:
    changes = [{}, {"mirror": True}, {"speed": 2.0}, {"mirror": True, "speed": 0.5}, {"to_s": 0.06}]
    chosen = [{"file": FILE, **change} for change in changes]
    environment = follower(tmp_path, reference={"clips": chosen})
    assert environment.playback is not None
    named = ["flight", "flight mirrored", "flight x2", "flight mirrored x0.5", "flight 2"]
    assert environment.playback.frames.names == named


FOLLOWS: dict[str, Any] = {"reference": {"clips": [{"file": FILE}]}, "reward": [{"kind": "track_joints"}]}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"reward": [{"kind": "track_joints"}]}, "track_joints needs a `reference`"),
        ({"observation": [{"kind": "reference"}]}, "The term reference needs a `reference`"),
        ({"termination": [{"kind": "far_from_reference"}]}, "far_from_reference needs a `reference`"),
        ({"metrics": [{"kind": "followed_reference"}]}, "followed_reference needs a `reference`"),
        ({**FOLLOWS, "reward": [{"kind": "alive"}]}, "No term of the reward reads the reference"),
        ({**FOLLOWS, "root": "arm"}, "the body 'arm' has no free joint"),
        ({**FOLLOWS, "reward": [{"kind": "track_joints", "joints": ["knee"]}]}, "that 'knee' matches"),
        ({**FOLLOWS, "terrain": {}}, "leave `terrain` or `reference` out"),
        ({**FOLLOWS, "reset": {"fallen": {}}}, "leave `reset.fallen` out"),
    ],
)
def test_what_does_not_go_with_a_reference_is_said(given: dict[str, Any], words: str) -> None:
    assert words in " ".join(problem.detail for problem in problems(parsed(**given), PROBE))


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ({"bodies": ["leg"]}, "no body that 'leg' matches; it has ball, arm"),
        ({"end_effectors": ["hand.*"]}, "no body that 'hand.*' matches"),
        ({"anchor": "bal"}, "no body 'bal'; did you mean 'ball'?"),
    ],
)
def test_bodies_that_the_model_lacks_are_said(reference: dict[str, Any], words: str) -> None:
    given = {**FOLLOWS, "reference": {**FOLLOWS["reference"], **reference}}
    assert words in " ".join(problem.detail for problem in problems(parsed(**given), PROBE))


def test_the_robots_task_needs_clips() -> None:
    with pytest.raises(Rejected, match="The task imitate needs `reference`"):
        catalog.resolve("g1", {"task": "imitate"})


def test_episodes_keep_the_positions_of_the_clip_beside_their_own(tmp_path: Path) -> None:
    environment = follower(tmp_path, reference={"random_phase": 0.0})
    [episode] = rollout(environment, zero_policy(1), key=KEY, num_steps=4, num_episodes=1).episodes
    assert episode.reference is not None
    np.testing.assert_allclose(episode.reference[:, 0], DT * np.arange(5), atol=1e-6)
    assert episode.reference.shape == episode.qpos.shape
    half = cut(episode, 2).reference
    assert half is not None
    np.testing.assert_array_equal(half, episode.reference[:3])
