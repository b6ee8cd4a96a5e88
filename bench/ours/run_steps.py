"""Engines under one body, in turns: `python -m bench.ours.run_steps FOLDER`.

Request: environment, or model: the file of a user's own body; engines, the one to judge first; num_envs, how
many to step, for each measurement; rounds; steps_per_call, the control steps in a compiled loop;
own_settings, whether every engine solves under the model's own settings. Bodies move under random controls
from their start, and are measured after a second of their time, when they touch what they fall on.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.measure.child import answer
from core.physics.availability import EngineName


def work(request: dict[str, Any]) -> dict[str, Any]:
    """rates: by engine and number of environments, control steps per second, round by round. ready_s: by
    engine, from its building to the end of its first control step, compiling included; ready_again_s: the
    same with its code on disk. same: by engine, whether a second loop from the same states ended in the
    same bits. finite: the share of environments that did not break."""
    from core.physics.compiled.code.kept_code import keep_code

    # Engines keep code in the folder until the last one is built.
    with TemporaryDirectory() as folder:
        keep_code(Path(folder))
        ready_s, ready_again_s = (
            {engine: _ready_s(request, engine) for engine in request["engines"]} for _ in range(2)
        )
        return {**_stepped(request), "ready_s": ready_s, "ready_again_s": ready_again_s}


def _stepped(request: dict[str, Any]) -> dict[str, Any]:
    """rates, same and finite of `work`."""
    import jax

    from core.physics.choose import engine_builder

    rates: dict[str, dict[str, list[float]]] = {}
    told: dict[str, dict[str, Any]] = {"same": {}, "finite": {}}
    for num_envs in request["num_envs"]:
        loops = dict[str, Callable[[], Any]]()
        for engine in request["engines"]:
            body = _body(request, engine_builder(engine))
            loop = _loop(body, num_envs, request["steps_per_call"])
            first = jax.block_until_ready(loop())
            again = jax.block_until_ready(loop())
            told["same"].setdefault(engine, bool((first.qpos == again.qpos).all()))
            told["finite"].setdefault(engine, float(jax.numpy.isfinite(first.qpos).all(axis=1).mean()))
            loops[engine] = loop
        for _ in range(request["rounds"]):
            for engine, loop in loops.items():
                began = time.perf_counter()
                jax.block_until_ready(loop())
                rate = num_envs * request["steps_per_call"] / (time.perf_counter() - began)
                rates.setdefault(engine, {}).setdefault(str(num_envs), []).append(rate)
    return {"rates": rates, **told}


def _ready_s(request: dict[str, Any], engine: EngineName) -> float:
    """Seconds from the building of the engine to the end of one control step."""
    import jax
    import jax.numpy as jnp

    from core.physics.choose import engine_builder

    num_envs = request["num_envs"][0]
    jax.block_until_ready(jax.jit(jnp.sin)(jnp.ones(num_envs)))  # JAX itself is ready before.
    jax.clear_caches()
    began = time.perf_counter()
    body = _body(request, engine_builder(engine))
    sizes = (body.model.nq, body.model.nv, body.model.nu)
    qpos, qvel, ctrl = (jnp.zeros((num_envs, size)) for size in sizes)
    shapes = jax.eval_shape(jax.vmap(body.engine.reset), qpos, qvel)
    states = jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), shapes)
    jax.block_until_ready(jax.jit(jax.vmap(body.engine.step))(states, ctrl))
    return time.perf_counter() - began


@dataclass(frozen=True)
class _Body:
    """dt: seconds of a control step."""

    engine: Any
    model: Any
    dt: float


def _body(request: dict[str, Any], build: Any) -> _Body:
    """The engine that the environment asks for."""
    from core.environments import catalog

    made = list[_Body]()

    def build_and_keep(model: Any, num_substeps: int, derived: tuple[str, ...], **more: Any) -> Any:
        engine = build(model, num_substeps, derived, **({} if request["own_settings"] else more))
        made.append(_Body(engine, model, num_substeps * model.opt.timestep))
        return engine

    if path := request.get("model"):
        with TemporaryDirectory() as folder:
            _make_own(Path(path), Path(folder, "model"), build_and_keep)
    else:
        info = catalog.find(request["environment"])
        catalog.make(info, catalog.parse_options(info, {}), build_and_keep)
    return made[0]


def _make_own(source: Path, sent: Path, build: Any) -> None:
    """A user's environment of terms that fit every body. sent: where the model is put as one file."""
    import mujoco

    from core.environments import catalog

    sent.write_text(mujoco.MjSpec.from_file(str(source)).to_xml())
    terms = {"reward": [{"kind": "alive"}], "termination": []}
    info = catalog.find("mjcf")
    catalog.make(info, catalog.parse_options(info, {"model": f"sha256:{'0' * 64}", **terms}), build, sent)


def _loop(body: _Body, num_envs: int, steps: int) -> Callable[[], Any]:
    """Steps all environments from the same states, under controls that change every 5 steps."""
    import jax
    import jax.numpy as jnp

    from core.physics.model import initial_qpos

    model, keys = body.model, jax.random.split(jax.random.key(0), 2)
    limited = model.actuator_ctrllimited.astype(bool)[:, None]
    low, high = jnp.where(limited, model.actuator_ctrlrange, jnp.array([-1.0, 1.0])).T
    move = jax.vmap(body.engine.step)

    def run(states: Any, num_steps: int, key: jax.Array) -> Any:
        def step(states: Any, number: jax.Array) -> tuple[Any, None]:
            random = jax.random.uniform(jax.random.fold_in(key, number // 5), (num_envs, model.nu))
            return move(states, low + 0.5 * (1.0 + 0.6 * (random - 0.5)) * (high - low)), None

        return jax.lax.scan(step, states, jnp.arange(num_steps))[0]

    qpos = jnp.tile(jnp.asarray(initial_qpos(model), jnp.float32), (num_envs, 1))
    qvel = 0.1 * jax.random.normal(keys[0], (num_envs, model.nv))
    begun = jax.jit(jax.vmap(body.engine.reset))(qpos, qvel)
    fallen = jax.jit(run, static_argnums=1)(begun, round(1.0 / body.dt), keys[0])
    timed = jax.jit(run, static_argnums=1)
    return lambda: timed(fallen, steps, keys[1])


if __name__ == "__main__":
    answer(work)
