"""A trained body that the browser steps with MuJoCo: it stands, is pushed, falls and starts again."""

import io
import json
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from core.algorithms.export.contract import PolicyOrigin, contract
from core.algorithms.export.network import PolicyLayer, PolicyNetwork
from core.algorithms.export.numpy_file import numpy_file
from core.algorithms.ppo.spec import PPOSpec
from core.environments.mujoco_env import MujocoEnv
from core.jobs.status import JobStatus
from core.rendering.replay.replay import replay_of, scene_of
from core.rendering.timeline import EpisodeMotion
from gaitway import exported_policy
from tests.api.conftest import Attempt, Stack, job
from tests.api.pages.conftest import MakeTab, Tab, flaws
from tests.exports import numpy_file_of, policy_file
from tests.extra import extra
from tests.unit.environments.test_simulation import BODIES, of_a_user, of_the_catalog

BINARY = "application/octet-stream"
# Its twelve motors are servos.
QUADRUPED = Path("examples/quadruped.xml").read_text()


# The page's own modules observe and act from a start, without the worker that the page runs them in.
STEPPED = """async ({recipe, policy, qpos, qvel, numSteps}) => {
  const pages = document.querySelector("script[src]").src.replace("app.js", "");
  const [{default: load}, {Simulation}, {readPolicy}] = await Promise.all(
    ["vendor/mujoco.js", "lib/push/simulation.js", "lib/push/policy.js"].map((one) => import(pages + one)));
  const bytes = new Uint8Array(policy).buffer;
  const simulation = new Simulation(await load(), recipe, readPolicy(bytes));
  simulation.data.qpos.set(qpos);
  simulation.data.qvel.set(qvel);
  simulation.begin();
  const seen = [simulation.observation];
  const done = [];
  const ends = [];
  while (done.length < numSteps) {
    for (let i = 0; i < recipe.num_substeps; i++) simulation.step();
    seen.push(simulation.observation);
    done.push([...simulation.action]);
    ends.push(Number(simulation.hasEnded));
  }
  return [seen, done, ends];
}"""


def policy_of(environment: MujocoEnv, scale: float, trained_steps: int = 1000) -> bytes:
    """`policy.npz` of two layers with random weights; if the scale is 0, it does nothing."""
    random = np.random.default_rng(0)
    sizes = [(environment.observation_size, 16), (16, 2 * environment.action_size)]
    layers = tuple(
        PolicyLayer(
            random.normal(0, scale, size).astype(np.float32),
            random.normal(0, scale, size[1]).astype(np.float32),
        )
        for size in sizes
    )
    mean = np.full(environment.observation_size, 0.1, np.float32)
    network = PolicyNetwork(mean, 2 * np.ones_like(mean), 5.0, layers, "swish", "state", 1)
    return numpy_file(
        network, contract(network, PolicyOrigin("ppo", "body", {}, environment.dt, trained_steps))
    )


@cache
def files(folder: Path | None = None) -> dict[str, tuple[str, bytes]]:
    """The role and content of an ant's files, or of the tutorial's robot (written to `folder`); its policy
    does nothing."""
    # Brax's noise puts some starts into the floor, which throws the body out of its range.
    calm = {"reset_noise_scale": 0.01}
    ant = of_the_catalog("ant", calm) if folder is None else of_a_user(folder, QUADRUPED)
    return files_of(ant, policy_of(ant, 0.0))


def files_of(ant: MujocoEnv, policy: bytes) -> dict[str, tuple[str, bytes]]:
    """The role and content of a body's files."""
    qpos = np.array([ant.initial_qpos, ant.initial_qpos], float)
    motion = EpisodeMotion(np.array([0.0, 0.05]), qpos)
    facts = {"num_steps": 1, "duration_s": 0.05, "terminated": False}
    return {
        "scene.glb": ("scene", scene_of(ant.model, qpos[0], ant.tracked_body)),
        "replay.bin": ("replay", replay_of(ant.model, [motion], [np.zeros(1)], [facts], ant.tracked_body)),
        "simulation.json": ("simulation", json.dumps(ant.simulation().document()).encode()),
        "policy.npz": ("export", policy),
    }


# One ground, so that the page begins on it.
STAIRS: dict[str, Any] = {
    "terrain": {"kinds": ["stairs_down"], "levels": [4, 4]},
    "observation": [{"kind": "height_scan"}, {"kind": "foot_height"}, {"kind": "joint_positions"}],
}
CASES: list[tuple[str, dict[str, Any]]] = [
    *((body, {}) for body in BODIES),
    ("rodent", {}),
    ("corridor", {"num_next_obstacles": 2}),
    ("corridor", {"walker": "rodent", "arena": "walls", "num_next_obstacles": 10, "start_x": 2.0}),
    ("g1", {}),
    ("go1", {}),
    ("go1", STAIRS),
]


@pytest.mark.parametrize(("body", "options"), [CASES[0], *extra(*CASES[1:])])
def test_the_browser_observes_and_acts_as_the_environment_does(
    browser: Browser, stack: Stack, body: str, options: dict[str, Any]
) -> None:
    environment = of_the_catalog(body, options)
    policy = policy_of(environment, 0.3)
    recipe = environment.simulation().document()
    if recipe["command"]:  # Without a key it is zero.
        environment = environment.told(np.zeros(len(recipe["command"]), np.float32))
    state = environment.reset(jax.random.key(3))
    # The page's own policy forbids WebAssembly outside the worker.
    page = browser.new_page(bypass_csp=True)
    page.goto(f"http://127.0.0.1:{stack.port}/#/workers")
    given = {
        "recipe": recipe,
        "policy": list(policy),
        "qpos": np.asarray(state.physics.qpos).tolist(),
        "qvel": np.asarray(state.physics.qvel).tolist(),
        "numSteps": 3,
    }
    seen, done, ends = page.evaluate(STEPPED, given)
    page.context.close()
    act = exported_policy.load(io.BytesIO(policy))
    np.testing.assert_allclose(seen[0], state.obs, rtol=1e-3, atol=1e-3)
    for observation, before, action, ended in zip(seen[1:], seen, done, ends, strict=False):
        np.testing.assert_allclose(action, act(before), atol=1e-5)
        state = environment.step(state, jax.numpy.array(action))
        np.testing.assert_allclose(observation, state.obs, rtol=1e-2, atol=1e-2)
        assert ended == state.done


# The page's own module acts once.
ACTED = """async ({policy, observation}) => {
  const pages = document.querySelector("script[src]").src.replace("app.js", "");
  const {readPolicy} = await import(pages + "lib/push/policy.js");
  return [...readPolicy(new Uint8Array(policy).buffer).act(Float64Array.from(observation))];
}"""


def test_the_browser_acts_with_an_encoder_as_the_file_says(browser: Browser, stack: Stack) -> None:
    network = {"kind": "intention", "latent": 2, "encoder": [5], "decoder": [6], "places": [[2, 1], [0, 1]]}
    seen = np.random.default_rng(0).normal(size=(8, 4)).astype(np.float32)
    policy = numpy_file_of(policy_file(PPOSpec.model_validate({"network": network}), seen, 3))
    page = browser.new_page()
    page.goto(f"http://127.0.0.1:{stack.port}/#/workers")
    action = page.evaluate(ACTED, {"policy": list(policy), "observation": seen[0].tolist()})
    page.context.close()
    np.testing.assert_allclose(action, exported_policy.load(io.BytesIO(policy))(seen[0]), atol=1e-5)


# The page's own module begins an episode, without noise.
BEGUN = """async (recipe) => {
  const pages = document.querySelector("script[src]").src.replace("app.js", "");
  const [{default: load}, {Simulation}] = await Promise.all(
    ["vendor/mujoco.js", "lib/push/simulation.js"].map((one) => import(pages + one)));
  const {data} = new Simulation(await load(), recipe, {about: {action: {held_steps: 1}}});
  return [data.qpos, data.qvel, data.act].map((values) => [...values]);
}"""
# A hinge that a filtered motor drives, with a keyframe in motion.
MOVING = """<mujoco><worldbody><body name="arm" pos="0 0 1">
  <joint name="j" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/></body></worldbody>
  <actuator><general joint="j" dyntype="filter" dynprm=".5" gainprm="4" ctrlrange="-1 1"/></actuator>
  <keyframe><key name="moving" qpos=".4" qvel="3" act=".7"/></keyframe></mujoco>"""


@pytest.mark.extra
def test_the_browser_begins_in_the_motion_of_a_keyframe(
    browser: Browser, stack: Stack, tmp_path: Path
) -> None:
    begins = {"keyframe": "moving", "position_noise": 0.0, "velocity_noise": 0.0}
    environment = of_a_user(tmp_path, MOVING, reset=begins, reward=[{"kind": "alive"}])
    # The page's own policy forbids WebAssembly outside the worker.
    page = browser.new_page(bypass_csp=True)
    page.goto(f"http://127.0.0.1:{stack.port}/#/workers")
    qpos, qvel, act = page.evaluate(BEGUN, environment.simulation().document())
    page.context.close()
    np.testing.assert_allclose([*qpos, *qvel, *act], [0.4, 3.0, 0.7], rtol=1e-6)


# A cart on three slides, whose servos move it: at once, as it is told.
CART = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody>
  <geom name="floor" type="plane" size="5 5 1"/>
  <body name="cart" pos="0 0 .2"><freejoint/><geom name="hull" type="box" size=".2 .1 .1" mass="1"/></body>
  </worldbody><actuator>
  <general name="x" site="centre" gear="1 0 0 0 0 0"/><general name="y" site="centre" gear="0 1 0 0 0 0"/>
  <general name="turn" site="centre" gear="0 0 0 0 0 1"/></actuator></mujoco>""".replace(
    'mass="1"/>', 'mass="1"/><site name="centre"/>'
)
OBEYS: dict[str, Any] = {
    "root": "cart",
    "command": {"kind": "velocity", "forward": [-1.0, 2.0]},
    "observation": [{"kind": "command"}, {"kind": "base_linear_velocity"}, {"kind": "base_angular_velocity"}],
    "reward": [{"kind": "track_linear_velocity"}],
    "reset": {"position_noise": 0.0, "velocity_noise": 0.0},
}


def obedient(environment: MujocoEnv) -> bytes:
    """A policy whose force is what the velocity lacks: command less velocity, forward, left and turning."""
    lacks = np.zeros((9, 6), np.float32)
    for axis, place in enumerate((3, 4, 8)):
        lacks[axis, axis], lacks[place, axis] = 1.0, -1.0
    # A layer that bends nothing comes first, since the last one is never bent.
    whole = PolicyLayer(np.eye(9, dtype=np.float32), np.full(9, 100.0, np.float32))
    layers = (whole, PolicyLayer(lacks, np.zeros(6, np.float32)))
    network = PolicyNetwork(np.zeros(9, np.float32), np.ones(9, np.float32), None, layers, "relu", "state", 1)
    return numpy_file(network, contract(network, PolicyOrigin("ppo", "body", {}, environment.dt, 1000)))


@pytest.fixture
def attempt(stack: Stack) -> Attempt:
    return Attempt(stack, job(name="push", algorithm={"kind": "ppo", "num_timesteps": 1000}))


def keep(attempt: Attempt, files: dict[str, tuple[str, bytes]]) -> None:
    for name, (role, content) in files.items():
        follows = role == "simulation" and bool(json.loads(content)["command"])
        facts = {"can_run": True, "follows_commands": follows} if role == "simulation" else {}
        attempt.keep(name, content, role=role, media_type=BINARY, metadata=facts)


@pytest.fixture
def training(attempt: Attempt) -> Attempt:
    """The attempt at a running job whose ant can be pushed."""
    keep(attempt, files())
    return attempt


@pytest.fixture
def pushed(training: Attempt) -> str:
    """The id of a finished job whose ant can be pushed."""
    training.end(JobStatus.SUCCEEDED)
    return training.id


def standing(tab: Tab, job_id: str) -> Page:
    """The page, once MuJoCo has placed the body."""
    page = tab.open(f"#/jobs/{job_id}/push")
    expect(page.get_by_text("Take hold of the body and pull.")).to_be_visible(timeout=60_000)
    return page


def position(page: Page) -> Any:
    """Where the torso is, [3] in m."""
    said = page.locator("canvas").get_attribute("data-position") or ""
    return np.array([float(part) for part in said.split()])


def until(page: Page, condition: str) -> None:
    """Wait for a condition on the torso's `x`, `y`, `z` and the `time`."""
    page.wait_for_function(
        f"""() => {{
          const {{ position, time }} = document.querySelector("canvas").dataset;
          const [x, y, z] = position.split(" ").map(Number);
          return {condition};
        }}"""
    )


def test_mujoco_is_loaded_only_here_and_under_a_policy_of_its_own(tab: Tab, pushed: str) -> None:
    asked: list[str] = []
    tab.page.on("request", lambda request: asked.append(request.url))
    page = tab.open(f"#/jobs/{pushed}/replay?t=0")
    link = page.get_by_role("link", name="Push it, and see whether it recovers")
    expect(link).to_be_visible()
    assert not [url for url in asked if "mujoco" in url]
    link.click()
    expect(page.get_by_text("Take hold of the body and pull.")).to_be_visible(timeout=60_000)
    assert [url for url in asked if url.endswith("vendor/mujoco.wasm")]


def test_a_body_falls_to_its_feet_and_a_push_moves_it(tab: Tab, pushed: str) -> None:
    page = standing(tab, pushed)
    # The tests' browser asks for less motion, so the page opens paused.
    page.get_by_role("button", name="Play").click()
    until(page, "time > 1")
    still = position(page)
    # The camera looks along y: right is x. Twice the weight for 0.2 s is up to 4 m/s.
    page.get_by_label("Strength").select_option("2")
    page.get_by_role("button", name="Push it right").click()
    until(page, f"x > {still[0] + 0.3}")
    page.keyboard.press("Tab")
    page.get_by_role("group", name="The trained body").focus()
    # It has to come to rest first: on a slow machine it slides on while the page is asked where it is.
    until(page, "time > 4")
    here = position(page)
    page.keyboard.press("ArrowLeft")
    until(page, f"x < {here[0] - 0.1}")
    tab.picture("push-key")
    page.keyboard.press("r")
    expect(page.get_by_text("It starts again.")).to_be_visible()
    page.keyboard.press("Space")
    expect(page.get_by_role("button", name="Play")).to_be_visible()


def test_a_body_with_commands_goes_where_it_is_told(tab: Tab, attempt: Attempt, tmp_path: Path) -> None:
    cart = of_a_user(tmp_path, CART, **OBEYS)
    keep(attempt, files_of(cart, obedient(cart)))
    attempt.end(JobStatus.SUCCEEDED)
    page = tab.open(f"#/jobs/{attempt.id}/push")
    expect(page.get_by_text("Steer it with W A S D, Q and E")).to_be_visible(timeout=60_000)
    expect(page.get_by_role("link", name="Drive", exact=True)).to_be_visible()
    expect(page.get_by_role("group", name="The trained body")).to_be_focused()
    page.get_by_role("button", name="Play").click()
    until(page, "time > 0.5 && Math.hypot(x, y) < 0.01")
    page.keyboard.down("w")  # "Play" is in focus still.
    expect(page.get_by_role("row", name="forward, m/s").get_by_role("cell").first).to_have_text("2.00")
    until(page, "x > 0.5 && Math.abs(y) < 0.05")
    tab.picture("drive")
    # What it is told and what it does are seen beside it, without scrolling.
    expect(page.locator(".speeds")).to_be_in_viewport(ratio=1)
    expect(page.locator(".stage")).to_be_in_viewport(ratio=1)
    page.keyboard.up("w")
    expect(page.get_by_role("row", name="forward, m/s").get_by_role("cell").first).to_have_text("0.00")
    left = page.get_by_role("button", name="Walk left")
    left.hover()
    page.mouse.down()
    until(page, "y > 0.3")
    page.mouse.up()
    assert flaws(page) == []
    tab.picture("drive-narrow")


@pytest.mark.extra
def test_a_robot_stands_on_the_ground_that_is_chosen(make_tab: MakeTab, attempt: Attempt) -> None:
    go1 = of_the_catalog("go1", {"terrain": {"kinds": ["flat", "stairs_down", "slope_down"]}})
    keep(attempt, files_of(go1, policy_of(go1, 0.0)))
    attempt.end(JobStatus.SUCCEEDED)
    tab = make_tab(1280, False)
    page = tab.open(f"#/jobs/{attempt.id}/push")
    ground, level = page.get_by_label("Ground"), page.get_by_label("Level")
    expect(page.get_by_text("Steer it with W A S D, Q and E")).to_be_visible(timeout=60_000)
    assert (ground.input_value(), level.input_value()) == ("stairs_down", "4")
    page.get_by_role("button", name="Play").click()
    # Its untrained legs carry it for 2 s. Five stairs of 7.8 or 15 cm; 20 degrees over 2.25 m.
    stands = "time > 0.5 && time < 1.5 && Math.abs(z - {} - 0.25) < 0.03"
    until(page, stands.format(0.389))
    tab.picture("drive-stairs")
    level.select_option("9")
    expect(page.get_by_role("group", name="The trained body")).to_be_focused()
    until(page, stands.format(0.75))
    tab.picture("drive-stairs-steep")
    ground.select_option("slope_down")
    until(page, stands.format(0.819))
    tab.picture("drive-slope")
    ground.select_option("flat")
    until(page, stands.format(0.0))
    tab.picture("drive-flat")
    assert flaws(page) == []


@pytest.mark.extra
def test_the_tutorials_robot_whose_motors_are_servos_is_pushed(
    tab: Tab, attempt: Attempt, tmp_path: Path
) -> None:
    """9.1: MuJoCo 3.14, which the page has, refused what 3.17 writes of servos."""
    keep(attempt, files(tmp_path))
    attempt.end(JobStatus.SUCCEEDED)
    page = standing(tab, attempt.id)
    page.get_by_role("button", name="Play").click()
    until(page, "time > 0.5")
    x, y, _ = position(page)
    page.get_by_label("Strength").select_option("2")
    page.get_by_role("button", name="Push it right").click()
    until(page, f"Math.hypot(x - {x}, y - {y}) > 0.1")
    tab.picture("push-servos")


@pytest.mark.extra
def test_a_drag_pulls_the_body_until_it_falls_and_it_starts_again(tab: Tab, pushed: str) -> None:
    page = standing(tab, pushed)
    page.get_by_role("button", name="Play").click()
    until(page, "time > 0.5")
    box = page.locator("canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 150, steps=5)
    # Episodes of the ant end above 1 m.
    until(page, "z > 0.9")
    tab.picture("push-drag")
    expect(page.get_by_text("It fell, or left its range, after")).to_be_visible()
    page.mouse.up()
    until(page, "time < 0.5")


@pytest.mark.extra
def test_a_running_trainings_newest_policy_takes_over(tab: Tab, training: Attempt) -> None:
    page = standing(tab, training.id)
    page.get_by_role("button", name="Play").click()
    expect(page.get_by_text("Policy at step 1,000; the training's next one takes its place")).to_be_visible()
    until(page, "time > 1")
    tab.picture("push-running")
    # Large weights bend the ant's legs as far as they go.
    newer = policy_of(of_the_catalog("ant"), 3.0, 2000)
    x, y, _ = position(page)
    training.keep("policy.npz", newer, role="export", media_type=BINARY, step=2000)
    training.say("artifact", name="policy.npz")
    expect(page.get_by_text("Policy at step 2,000")).to_be_visible()
    until(page, f"Math.hypot(x - {x}, y - {y}) > 0.05")
    tab.picture("push-newer")
    training.end(JobStatus.SUCCEEDED)
    expect(page.get_by_text("the training's next one")).to_have_count(0)
    expect(page.get_by_text("Policy at step 2,000", exact=True)).to_be_visible()


@pytest.mark.extra
def test_a_running_training_is_pushed_from_its_first_replay_on(tab: Tab, attempt: Attempt) -> None:
    page = tab.open(f"#/jobs/{attempt.id}/push")
    expect(page.get_by_text("is running and has no simulation yet")).to_be_visible()
    link = page.get_by_role("link", name="Push", exact=True)
    keep(attempt, dict(reversed(files().items())))
    attempt.say("artifact", name="replay.bin")
    expect(page.get_by_text("Take hold of the body and pull.")).to_be_visible(timeout=60_000)
    expect(link).to_be_visible()


@pytest.mark.extra
def test_a_body_that_cannot_be_pushed_says_why(tab: Tab, attempt: Attempt) -> None:
    refusal = "This body cannot be pushed: it is made of dreams."
    content = json.dumps({"refusal": refusal}).encode()
    attempt.keep(
        "simulation.json", content, role="simulation", media_type=BINARY, metadata={"can_run": False}
    )
    attempt.end(JobStatus.SUCCEEDED)
    page = tab.open(f"#/jobs/{attempt.id}/push")
    expect(page.get_by_text(refusal)).to_be_visible()
    page = tab.open(f"#/jobs/{attempt.id}/replay")
    expect(page.get_by_role("link", name="Push")).to_have_count(0)


@pytest.mark.extra
def test_a_model_that_mujoco_there_does_not_read_says_so(tab: Tab, attempt: Attempt) -> None:
    role, content = files()["simulation.json"]
    changed = content.replace(b"<worldbody>", b"<world_of_tomorrow>")
    keep(attempt, {**files(), "simulation.json": (role, changed)})
    page = tab.open(f"#/jobs/{attempt.id}/push")
    said = page.get_by_role("alert")
    expect(said).to_contain_text("cannot run this model of MuJoCo", timeout=60_000)
    # It stands where the body would, not below, where nobody sees it.
    assert said.bounding_box() == page.locator(".stage").bounding_box()
    expect(page.get_by_role("button", name="Play")).to_be_disabled()
    tab.picture("push-refused")


@pytest.mark.extra
@pytest.mark.parametrize(("width", "dark"), [(1280, True), (380, False)])
def test_the_view_is_accessible_and_fits(make_tab: MakeTab, pushed: str, width: int, dark: bool) -> None:
    tab = make_tab(width, dark)
    standing(tab, pushed)
    assert tab.violations() == []
    assert tab.overflow() == 0
    tab.picture(f"push-{width}-{'dark' if dark else 'light'}")
