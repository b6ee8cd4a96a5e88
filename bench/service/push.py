"""Measures a body that the browser steps: how soon it is there, how fast it is drawn, how near to ours."""

import os

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import base64
import io
import json
import time
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Browser

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result
from bench.service.replay import PICTURES, published
from bench.stack.browser import stack_and_browser
from core.algorithms.catalog import resolve
from core.algorithms.events import Progress
from core.algorithms.export.contract import Origin, contract
from core.algorithms.export.network import network_of
from core.algorithms.export.numpy_file import numpy_file
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.run import make_run
from core.environments import catalog
from core.environments.mujoco_env import MujocoEnv
from core.jobs.job import ArtifactRole
from core.physics.choose import engine_builder
from core.rendering.replay.replay import replay_of, scene_of
from core.rendering.timeline import Motion
from gaitway import exported_policy

_BODIES = {"ant": 60.0, "half_cheetah": 60.0, "hopper": 60.0, "walker2d": 60.0, "humanoid": 60.0}
_STARTS = 32
_SECONDS = 6.0
# Episodes from given starts, on the page's own modules: states [T+1], actions [T], of each.
_ROLLED = """async ({recipe, policy, starts, numSteps}) => {
  const pages = document.querySelector("script[src]").src.replace("app.js", "");
  const [{default: load}, {Simulation}, {readPolicy}] = await Promise.all(
    ["vendor/mujoco.js", "lib/push/simulation.js", "lib/push/policy.js"].map((one) => import(pages + one)));
  const bytes = Uint8Array.from(atob(policy), (letter) => letter.charCodeAt(0)).buffer;
  const simulation = new Simulation(await load(), recipe, readPolicy(bytes));
  const began = performance.now();
  let substeps = 0;
  const episodes = starts.map(([qpos, qvel]) => {
    simulation.reset();
    simulation.data.qpos.set(qpos);
    simulation.data.qvel.set(qvel);
    simulation.begin();
    const told = { qpos: [qpos], qvel: [qvel], action: [] };
    while (told.action.length < numSteps && (!told.action.length || !simulation.hasEnded())) {
      for (let i = 0; i < recipe.num_substeps; i++, substeps++) simulation.step();
      told.qpos.push([...simulation.data.qpos]);
      told.qvel.push([...simulation.data.qvel]);
      told.action.push([...simulation.action]);
    }
    return told;
  });
  const seconds = (performance.now() - began) / 1000;
  return { episodes, realTime: (substeps * simulation.model.opt.timestep) / seconds };
}"""


def measure(options: Options) -> Result:
    """Train each body for a minute; run the same episodes here and in Chromium; look at it there."""
    rows: list[dict[str, Any]] = []
    figures: list[Figure] = []
    bodies = {"ant": 3.0} if options.quick else _BODIES
    with stack_and_browser() as (parts, browser):
        for body, seconds in bodies.items():
            policy, num_steps = _trained(body, seconds)
            environment = _environment(body, "native")
            document = environment.simulation().document()
            returns, real_time = _compared(browser, parts.url, environment, document, policy)
            seen = _seen(browser, parts.url, published(parts, body, _files(environment, document, policy)))
            rows += [{"body": body, "here": here, "browser": there} for here, there in returns.T.tolist()]
            figures += _figures(body, num_steps, returns, real_time, seen)
    return Result(
        name="push",
        title="A body that the browser steps",
        command="./run bench push",
        quick=options.quick,
        machine=this_machine(),
        figures=figures,
        rows=rows,
        notes=[
            f"Each policy trained for some {_BODIES['ant']:g} s on this CPU. Returns are means over "
            f"{_STARTS} starts, the same for both: here on `native`, in the browser on MuJoCo's WebAssembly. "
            "Chromium draws in software beside the service, on the same cores.",
        ],
    )


def _figures(
    body: str, num_steps: int, returns: NDArray[np.float64], real_time: float, seen: tuple[float, float]
) -> list[Figure]:
    """returns: [2, starts], ours and the browser's."""
    ours, theirs = returns
    first, frames = seen
    return [
        _mean(f"{body}, trained for {num_steps:,} steps: return here", ours),
        _mean(f"{body}: return in the browser", theirs),
        Figure(name=f"{body}: stepped in the browser", value=real_time, unit="× real time"),
        Figure(name=f"{body}: from the address to the first picture", value=first, unit="s"),
        Figure(name=f"{body}: drawn in software", value=frames, unit="frames/s"),
    ]


def _mean(name: str, returns: NDArray[np.float64]) -> Figure:
    error = returns.std(ddof=1) / np.sqrt(len(returns))
    return Figure(name=name, value=returns.mean(), unit="", error=error)


def _environment(body: str, engine: Any) -> MujocoEnv:
    info = catalog.find(body)
    made = catalog.make(info, catalog.parse_options(info, {}), engine_builder(engine))
    if not isinstance(made, MujocoEnv):
        raise TypeError(f"{body} is not stepped by MuJoCo's data alone.")
    return made


def _trained(body: str, seconds: float) -> tuple[bytes, int]:
    """`policy.npz` after this many seconds of training, and its steps."""
    environment = _environment(body, "compiled")
    settings = resolve(PPOSpec(), catalog.find(body), "cpu")
    run = make_run(environment, settings, seed=0, checkpoint_every_steps=None)
    began: float | None = None
    for event in run.events():
        if isinstance(event, Progress):
            began = began or time.perf_counter()
            if time.perf_counter() - began > seconds:  # Wall time: a bench beside other work learns less.
                break
    network = network_of(run.policy())
    about = contract(network, Origin("ppo", body, {}, environment.dt, run.step))
    return numpy_file(network, about), run.step


def _files(
    environment: MujocoEnv, document: dict[str, Any], policy: bytes
) -> dict[str, tuple[ArtifactRole, bytes]]:
    """Of a job that has ended, by name."""
    qpos = np.array([document["qpos"]] * 2)
    motion, facts = Motion(np.array([0.0, environment.dt]), qpos), {"duration_s": environment.dt}
    model, body = environment.model, environment.tracked_body
    replay = replay_of(model, [motion], [np.zeros(1)], [{**facts, "num_steps": 1, "terminated": False}], body)
    return {
        "scene.glb": ("scene", scene_of(model, qpos[0], body)),
        "replay.bin": ("replay", replay),
        "simulation.json": ("simulation", json.dumps(document).encode()),
        "policy.npz": ("export", policy),
    }


def _compared(
    browser: Browser, url: str, environment: MujocoEnv, document: dict[str, Any], policy: bytes
) -> tuple[NDArray[np.float64], float]:
    """Returns [2, starts], ours and the browser's; and how much faster than time the browser steps."""
    act = exported_policy.load(io.BytesIO(policy))
    keys = jax.random.split(jax.random.key(0), _STARTS)
    step = jax.jit(jax.vmap(environment.step))
    first = state = jax.jit(jax.vmap(environment.reset))(keys)
    ours, lives = np.zeros(_STARTS), np.ones(_STARTS)
    for _ in range(environment.episode_length):
        state = step(state, act(np.asarray(state.obs)))
        ours += lives * np.asarray(state.reward)
        lives *= 1 - np.asarray(state.done)
    starts = [
        [np.asarray(first.physics.qpos[one]).tolist(), np.asarray(first.physics.qvel[one]).tolist()]
        for one in range(_STARTS)
    ]
    # The page's policy allows no WebAssembly outside the worker, which cannot be asked for whole episodes.
    page = browser.new_page(bypass_csp=True)
    page.set_default_timeout(300_000)
    page.goto(f"{url}/#/jobs")
    given = {
        "recipe": document,
        "policy": base64.b64encode(policy).decode(),
        "starts": starts,
        "numSteps": environment.episode_length,
    }
    told = page.evaluate(_ROLLED, given)
    page.context.close()
    theirs = [_return(environment, episode) for episode in told["episodes"]]
    return np.array([ours, theirs]), told["realTime"]


def _return(environment: MujocoEnv, episode: dict[str, Any]) -> float:
    """The sum of our rewards for the browser's actions in the browser's states."""
    qpos, qvel, action = (np.array(episode[name], np.float32) for name in ("qpos", "qvel", "action"))
    one = environment.reset(jax.random.key(0))
    physics = jax.vmap(environment.engine.reset)(qpos[:-1], qvel[:-1])
    many = jax.tree.map(lambda values: np.broadcast_to(values, (len(action), *np.shape(values))), one)
    return float(np.sum(jax.vmap(environment.step)(replace(many, physics=physics), action).reward))


def _seen(browser: Browser, url: str, job_id: str) -> tuple[float, float]:
    """Seconds until a new reader sees the body, and pictures a second after that."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(120_000)
    began = time.perf_counter()
    page.goto(f"{url}/#/jobs/{job_id}/push")
    page.locator("canvas[data-pictures]").wait_for()
    first = time.perf_counter() - began
    page.wait_for_timeout(1000 * _SECONDS)  # Until it has found how much this machine can draw.
    before, since = page.evaluate(PICTURES), time.perf_counter()
    page.wait_for_timeout(1000 * _SECONDS)
    drawn = (page.evaluate(PICTURES) - before) / (time.perf_counter() - since)
    page.context.close()
    return first, drawn
