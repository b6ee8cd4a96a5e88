"""What the walker's own camera costs: `python -m bench.ours.draw_egocentric FOLDER`.

Request: walker; num_envs; side, of each picture in pixels; depth_side, of each depth image; rounds; seconds,
at least, that a round spends on each measurement.
"""

import os

os.environ.setdefault("MUJOCO_GL", "egl")  # Before MuJoCo is loaded.

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from bench.measure.child import answer
from bench.measure.statistics import alternate
from core.environments import catalog
from core.environments.dm_control.corridor.egocentric import CAMERA
from core.environments.environment import Environment
from core.physics.choose import engine_builder
from core.rendering.gl import context_works


def work(request: dict[str, Any]) -> dict[str, Any]:
    """Seconds for all environments, round by round: step, of a control step; step_with_depth, of one that
    ends with a depth image; drawn, by OpenGL; cast, by MuJoCo Warp's rays. gl_renderer, warp_device: what
    drew them."""
    environment = _corridor(request["walker"], 0)
    seeing = _corridor(request["walker"], request["depth_side"])
    positions = _positions(environment, request["num_envs"])
    cast, device = _casting(environment.model, positions, request["side"])
    measured = alternate(
        request["rounds"],
        step=_seconds(_stepping(environment, request["num_envs"]), request["seconds"]),
        step_with_depth=_seconds(_stepping(seeing, request["num_envs"]), request["seconds"]),
        drawn=_seconds(_drawing(environment.model, positions, request["side"]), request["seconds"]),
        cast=_seconds(cast, request["seconds"]),
    )
    return {**measured, "gl_renderer": context_works(), "warp_device": device}


def _corridor(walker: str, egocentric_depth: int) -> Environment:
    info = catalog.find("corridor")
    options = {"walker": walker, "egocentric_depth": egocentric_depth}
    return catalog.make(info, catalog.parse_options(info, options), engine_builder("compiled"))


def _positions(environment: Environment, num_envs: int) -> np.ndarray:
    """[num_envs, nq]: where episodes begin."""
    states = jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(0), num_envs))
    return np.asarray(states.physics.qpos, np.float64)


def _stepping(environment: Environment, num_envs: int) -> Callable[[], None]:
    step = jax.jit(jax.vmap(environment.step))
    state = jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(0), num_envs))
    still = jnp.zeros((num_envs, environment.action_size))
    return lambda: jax.block_until_ready(step(state, still)) and None


def _drawing(model: mujoco.MjModel, positions: np.ndarray, side: int) -> Callable[[], None]:
    """As cheap as OpenGL draws them: no shadows, no reflections, no smooth edges."""
    model.vis.quality.offsamples = 0
    data, renderer = mujoco.MjData(model), mujoco.Renderer(model, side, side)
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        renderer.scene.flags[flag] = 0

    def draw() -> None:
        for row in positions:
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, CAMERA)
            renderer.render()

    return draw


def _casting(model: mujoco.MjModel, positions: np.ndarray, side: int) -> tuple[Callable[[], None], str]:
    import warp as wp
    from mujoco.mjx.third_party import mujoco_warp as mjw

    at_rest = mujoco.MjData(model)
    mujoco.mj_forward(model, at_rest)
    moved, data = mjw.put_model(model), mjw.put_data(model, at_rest, nworld=len(positions))
    data.qpos.assign(positions.astype(np.float32))
    context = mjw.create_render_context(
        model,
        nworld=len(positions),
        cam_res=(side, side),
        render_rgb=True,
        render_depth=False,
        cam_active=[CAMERA],
    )

    def cast() -> None:
        mjw.kinematics(moved, data)
        mjw.camlight(moved, data)
        mjw.refit_bvh(moved, data, context)
        mjw.render(moved, data, context)
        wp.synchronize()

    return cast, str(wp.get_device())


def _seconds(act: Callable[[], None], least_s: float) -> Callable[[], float]:
    """How long a call takes, in the mean over calls that take this long together, without compiling."""
    act()

    def measure() -> float:
        began, number = time.perf_counter(), 0
        while time.perf_counter() - began < least_s:
            act()
            number += 1
        return (time.perf_counter() - began) / number

    return measure


if __name__ == "__main__":
    answer(work)
