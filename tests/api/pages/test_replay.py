"""The replay in three dimensions, drawn by the browser without a GPU."""

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from core.jobs.status import JobStatus
from core.rendering.replay.poses import poses
from core.rendering.replay.replay import replay_of, scene_of
from tests.api.conftest import Attempt, Stack, job
from tests.api.pages.conftest import MakeTab, Tab
from tests.unit.rendering.replay.models import ARM, model_of, rolling

MODEL = model_of(ARM)
# It is told to walk on, and turns to the left beside that.
VELOCITIES = np.tile(np.array([[1.0, 0.0, 0.0], [0.9, 0.0, 1.25]]), (41, 1, 1))
MOTION = rolling(
    target=np.stack([np.linspace(0.5, 1.5, 41), np.full(41, -0.8)], axis=1), velocities=VELOCITIES
)
FACTS = {"num_steps": 40, "duration_s": 1.0, "terminated": False}


@pytest.fixture(scope="module")
def scene() -> bytes:
    return scene_of(MODEL, MOTION.qpos[0], 2)


def replay(num_episodes: int = 1) -> bytes:
    motions, rewards = [MOTION] * num_episodes, [np.full(40, 0.5)] * num_episodes
    return replay_of(MODEL, motions, rewards, [FACTS] * num_episodes, 2)


def keep(attempt: Attempt, scene: bytes, step: int | None = None, num_episodes: int = 1) -> None:
    attempt.keep("scene.glb", scene, role="scene", media_type="model/gltf-binary")
    content = replay(num_episodes)
    name = f"replay-{step}.bin"
    # Files of the same bytes have the same hash: a step makes each its own.
    attempt.keep(
        name,
        content + json.dumps(step).encode(),
        role="replay",
        media_type="application/octet-stream",
        step=step,
    )


@pytest.fixture
def attempt(stack: Stack) -> Attempt:
    return Attempt(stack, job(name="roll", algorithm={"kind": "ppo", "num_timesteps": 1000}))


def drawn(page: Page) -> Page:
    """The page, once it has drawn a picture of a replay."""
    expect(page.locator("canvas[data-pictures][data-shown]")).to_be_visible()
    return page


def pictures(page: Page) -> int:
    """How many pictures the stage has drawn."""
    return int(page.locator("canvas").get_attribute("data-pictures") or 0)


def after(page: Page, count: int) -> bytes:
    """The stage as it is seen after `count` pictures."""
    page.wait_for_function(
        """count => Number(document.querySelector("canvas").dataset.pictures) > count""", arg=count
    )
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return page.locator("canvas").screenshot()


def test_the_address_names_the_moment_and_controls_change_it(
    tab: Tab, attempt: Attempt, scene: bytes
) -> None:
    keep(attempt, scene, 100)
    page = drawn(tab.open(f"#/jobs/{attempt.id}/replay?t=0.5&contacts=1&shadows=1"))
    moment = page.get_by_role("slider", name="Moment")
    expect(moment).to_have_attribute("aria-valuetext", "0.50 s")
    # After 20 of 40 steps with a reward of 0.5 each.
    expect(page.get_by_text("0.50 s of 1.00 s · return 10.0")).to_be_visible()
    expect(page.get_by_role("row", name="turn, rad/s 0.00 1.25")).to_be_visible()
    tab.picture("replay-ball")
    moment.fill("0.8")
    expect(page.get_by_text("0.80 s of 1.00 s · return 16.0")).to_be_visible()
    assert "t=0.80" in page.url
    page.get_by_role("group", name="Replay of episode 1 at step 100").focus()
    page.keyboard.press("Home")
    expect(moment).to_have_attribute("aria-valuetext", "0.00 s")
    page.keyboard.press("Shift+ArrowRight")
    expect(moment).to_have_attribute("aria-valuetext", "1.00 s")
    page.keyboard.press("c")
    expect(page.get_by_label("Contacts")).not_to_be_checked()
    page.keyboard.press(",")
    expect(page.get_by_label("Speed")).to_have_value("0.5")
    page.keyboard.press("f")
    assert all(part in page.url for part in ("speed=0.5", "follow=0", "shadows=1"))
    assert "contacts" not in page.url
    page.keyboard.press("Space")
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    after(page, pictures(page) + 3)
    page.keyboard.press("Space")
    expect(page.get_by_role("button", name="Play")).to_be_visible()


@pytest.mark.extra
def test_a_running_job_without_a_video_plays_its_newest_replay(
    tab: Tab, attempt: Attempt, scene: bytes
) -> None:
    """9.5: its page said only that the video is made at the end."""
    page = tab.open(f"#/jobs/{attempt.id}")
    expect(page.get_by_text("The video is made at the end.")).to_be_visible()
    keep(attempt, scene, 100)
    attempt.say("artifact", name="replay-100.bin")
    drawn(page)
    page.get_by_role("button", name="Play").click()
    after(page, pictures(page) + 2)
    expect(page.get_by_text("The policy at step 100")).to_be_visible()
    assert tab.violations() == []
    tab.picture("overview-replay")
    attempt.keep("video.mp4")
    attempt.say("artifact", name="video.mp4")
    expect(page.get_by_text("Video at the end")).to_be_visible()
    expect(page.locator("canvas")).to_have_count(0)


@pytest.mark.extra
def test_a_replay_that_plays_is_left_without_an_error(tab: Tab, attempt: Attempt, scene: bytes) -> None:
    keep(attempt, scene, 100)
    page = drawn(tab.open(f"#/jobs/{attempt.id}/replay"))
    for _ in range(3):  # The error depended on the moment.
        page.get_by_role("button", name="Play").click()
        after(page, pictures(page) + 2)
        page.get_by_role("link", name="Files").click()
        expect(page.get_by_role("region", name="Files")).to_be_visible()
        page.get_by_role("link", name="Replay", exact=True).click()
        drawn(page)


@pytest.mark.extra
def test_the_mouse_turns_the_picture(tab: Tab, attempt: Attempt, scene: bytes) -> None:
    keep(attempt, scene, 100)
    page = drawn(tab.open(f"#/jobs/{attempt.id}/replay?t=0"))
    before, count = after(page, 0), pictures(page)
    box = page.locator("canvas").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 300, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 500, box["y"] + 220, steps=3)
    page.mouse.up()
    turned = after(page, count)
    assert turned != before
    count = pictures(page)
    page.get_by_role("button", name="Reset the view").click()
    assert after(page, count) != turned


def test_the_browser_reads_the_poses_that_the_worker_wrote(tab: Tab, attempt: Attempt, scene: bytes) -> None:
    keep(attempt, scene, 100)
    page = drawn(tab.open(f"#/jobs/{attempt.id}/replay?t=0"))
    # 0.2625 s lies half way between the frames 10 and 11.
    read: Sequence[Any] = page.evaluate(
        """async (href) => {
          const lib = document.querySelector("script[src]").src.replace("app.js", "lib/replay/");
          const { openReplay } = await import(lib + "fetching.js");
          const { Motion } = await import(lib + "motion.js");
          const motion = new Motion(await (await openReplay(href)).episode(0));
          const found = [];
          motion.poses(0.2625, (body, position, turn) => found.push([[...position], [...turn]]));
          const touched = [];
          motion.contacts(0.25, (index, at) => touched.push([...at]));
          return [found, touched, [...motion.target(0.25)]];
        }""",
        f"/jobs/{attempt.id}/replay",
    )
    found, touched, target = read
    expected = poses(MODEL, MOTION)
    unit = expected.scale_m / 32767
    position = expected.arrays["origin"][:, None] + unit * expected.arrays["position"]
    turns = expected.arrays["rotation"] / 32767.0
    turn = turns[10] + turns[11]
    np.testing.assert_allclose([one[0] for one in found], (position[10] + position[11]) / 2, atol=1e-5)
    np.testing.assert_allclose(
        [one[1] for one in found], turn / np.linalg.norm(turn, axis=1, keepdims=True), atol=1e-5
    )
    np.testing.assert_allclose(target, [0.75, -0.8, 0.25], atol=1e-5)
    assert len(touched) == expected.arrays["contact_count"][10]


def test_the_clip_that_a_body_follows_is_a_ghost_that_can_be_switched_off(
    tab: Tab, attempt: Attempt, scene: bytes
) -> None:
    attempt.keep("scene.glb", scene, role="scene", media_type="model/gltf-binary")
    reference = MOTION.qpos + np.array([0.0, 0.9, *[0.0] * 6])
    content = replay_of(MODEL, [replace(MOTION, reference=reference)], [np.full(40, 0.5)], [FACTS], 2)
    attempt.keep("replay-100.bin", content, role="replay", media_type="application/octet-stream", step=100)
    page = drawn(tab.open(f"#/jobs/{attempt.id}/replay?t=0.4"))
    tab.picture("replay-ghost")
    expect(page.get_by_label("Clip")).to_be_checked()
    shown = page.locator("canvas").screenshot()
    page.get_by_role("group", name="Replay of episode 1 at step 100").focus()
    count = pictures(page)
    page.keyboard.press("g")
    expect(page.get_by_label("Clip")).not_to_be_checked()
    assert "ghost=0" in page.url
    assert after(page, count) != shown


@pytest.mark.extra
def test_several_episodes_stand_over_each_other_or_side_by_side(
    tab: Tab, attempt: Attempt, scene: bytes
) -> None:
    keep(attempt, scene, 100, num_episodes=3)
    page = drawn(tab.open(f"#/jobs/{attempt.id}/replay?t=0.4&episode=2"))
    page.get_by_text("Episodes 2 of 3").click()
    page.get_by_role("checkbox", name="3 1.0 s").check()
    expect(page.get_by_role("img", name="Replay of episodes 2, 3 at step 100")).to_be_visible()
    page.get_by_label("Side by side").check()
    expect(page.get_by_text("return 8.0, 8.0")).to_be_visible()
    expect(page.locator("canvas[data-shown$='2,3 true']")).to_be_visible()
    assert all(part in page.url for part in ("episode=2", "episode=3", "beside=1"))
    tab.picture("replay-side-by-side")


@pytest.mark.extra
def test_the_newest_checkpoint_is_shown_as_soon_as_it_is_there(
    tab: Tab, attempt: Attempt, scene: bytes
) -> None:
    page = tab.open(f"#/jobs/{attempt.id}/replay")
    expect(page.get_by_text("is running and has no replay yet")).to_be_visible()
    keep(attempt, scene, 100)
    attempt.say("artifact", name="replay-100.bin")
    expect(page.get_by_role("img", name="Replay of episode 1 at step 100")).to_be_visible()
    keep(attempt, scene, 200)
    attempt.say("artifact", name="replay-200.bin")
    expect(page.get_by_role("img", name="Replay of episode 1 at step 200")).to_be_visible()
    page.get_by_role("slider", name="Checkpoint").fill("0")
    expect(page.get_by_role("img", name="at step 100")).to_be_visible()
    # Whoever looks at an older one keeps it.
    keep(attempt, scene, 300)
    attempt.say("artifact", name="replay-300.bin")
    expect(page.get_by_text("Policy at step 100 (1 of 3)")).to_be_visible()
    expect(page.get_by_role("img", name="at step 100")).to_be_visible()


@pytest.mark.extra
def test_the_last_states_of_a_lost_body_are_a_replay_of_their_own(
    tab: Tab, attempt: Attempt, scene: bytes
) -> None:
    keep(attempt, scene, 100)
    # The update lost it at its first step: there is a single state.
    target = None if MOTION.target is None else MOTION.target[:1]
    last = replace(MOTION, time=MOTION.time[:1], qpos=MOTION.qpos[:1], target=target)
    facts = {"num_steps": 0, "duration_s": 0.0, "terminated": True}
    attempt.keep(
        "replay-lost.bin",
        replay_of(MODEL, [last], [np.zeros(0)], [facts], 2),
        role="replay",
        media_type="application/octet-stream",
        step=150,
        metadata={"lost_body": True},
    )
    page = drawn(tab.open(f"#/jobs/{attempt.id}/replay"))
    expect(page.get_by_text("A body that was lost at step 150 (2 of 2)")).to_be_visible()
    expect(page.get_by_text("0.00 s of 0.00 s")).to_be_visible()
    page.get_by_role("slider", name="Checkpoint").fill("0")
    expect(page.get_by_text("Policy at step 100 (1 of 2)")).to_be_visible()


@pytest.mark.extra
def test_an_older_job_says_how_to_get_a_replay(tab: Tab, attempt: Attempt) -> None:
    attempt.keep("trajectory.npz", role="trajectory", media_type="application/x-npz")
    attempt.end(JobStatus.SUCCEEDED)
    page = tab.open(f"#/jobs/{attempt.id}/replay")
    expect(page.get_by_text("roll its policy out again")).to_be_visible()


@pytest.mark.extra
def test_a_damaged_file_says_so(tab: Tab, attempt: Attempt, scene: bytes) -> None:
    attempt.keep("scene.glb", scene, role="scene", media_type="model/gltf-binary")
    attempt.keep("replay.bin", b"no such thing", role="replay", media_type="application/octet-stream", step=1)
    page = tab.open(f"#/jobs/{attempt.id}/replay")
    expect(page.get_by_role("alert")).to_contain_text("This file is not a replay.")


@pytest.mark.extra
def test_three_js_is_loaded_only_with_a_replay(tab: Tab, attempt: Attempt, scene: bytes) -> None:
    keep(attempt, scene, 100)
    attempt.keep("video-100.mp4", step=100)  # Without one, the job's page shows the replay.
    asked: list[str] = []
    tab.page.on("request", lambda request: asked.append(request.url))
    page = tab.open(f"#/jobs/{attempt.id}")
    link = page.get_by_role("link", name="See it from any side")
    expect(link).to_be_visible()
    assert not [url for url in asked if "three" in url]
    link.click()
    drawn(page)
    assert [url for url in asked if "three" in url]


@pytest.mark.extra
@pytest.mark.parametrize(("width", "dark"), [(1280, True), (380, False)])
def test_the_replay_is_accessible_and_fits(
    make_tab: MakeTab, attempt: Attempt, scene: bytes, width: int, dark: bool
) -> None:
    keep(attempt, scene, 100, num_episodes=2)
    tab = make_tab(width, dark)
    drawn(tab.open(f"#/jobs/{attempt.id}/replay?t=0.3&episode=1&episode=2"))
    assert tab.violations() == []
    assert tab.overflow() == 0
    tab.picture(f"replay-{width}-{'dark' if dark else 'light'}")
