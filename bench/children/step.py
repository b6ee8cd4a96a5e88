"""Engines under one body, in turns.

Request: body; kept, a folder that may have it, or null; num_envs, by engine; rounds, round_s; steps_per_call,
the control steps in a compiled loop; limit_s, for an engine's code; turn, a file by whose lock
children take turns: several make code at once, and each measures alone.
"""

import fcntl
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

from bench.child import answer

# Environments of which C MuJoCo counts the contacts.
_LOOKED_AT = 64


def work(request: dict[str, Any]) -> dict[str, Any]:
    """By engine: rates, control steps per second, round by round; ready_s, from the engine's construction to
    the end of its first control step; sound, the share of environments that are finite at the end; missing,
    why there is no rate. contacts: of an environment, a second of its time after its start."""
    from bench.bodies import find

    told: dict[str, Any] = {"rates": {}, "ready_s": {}, "sound": {}, "missing": {}, "contacts": None}
    with _turn(request["turn"], fcntl.LOCK_SH):
        body = find(request["body"], Path(request["kept"]) if request["kept"] else None)
        loops = dict[str, _Loop]()
        for engine, num_envs in request["num_envs"].items():
            began = time.perf_counter()
            try:
                made = _within(request["limit_s"], lambda e=engine, n=num_envs: _Loop(body, e, n))
            except TimeoutError:
                told["missing"][engine] = f"its code was not ready after {request['limit_s']:.0f} s"
            except Exception as error:  # what an engine says is the answer
                told["missing"][engine] = f"refused: {error}"
            else:
                loops[engine] = made
                told["ready_s"][engine] = time.perf_counter() - began
    with _turn(request["turn"], fcntl.LOCK_EX):
        for engine, loop in loops.items():
            loop.settle(request["steps_per_call"])
            told["contacts"] = told["contacts"] or loop.contacts()
            told["rates"][engine] = list[float]()
        for _ in range(request["rounds"]):
            for engine, loop in loops.items():
                told["rates"][engine].append(loop.rate(request["steps_per_call"], request["round_s"]))
        told["sound"] = {engine: loop.sound() for engine, loop in loops.items()}
    return told


@contextmanager
def _turn(path: str, kind: int) -> Iterator[None]:
    with open(path) as file:
        fcntl.flock(file, kind)
        yield


def _within(limit_s: float, make: Callable[[], Any]) -> Any:
    """What it makes. Raises TimeoutError; it is still being made then."""
    made = Future[Any]()

    def run() -> None:
        try:
            made.set_result(make())
        except BaseException as error:
            made.set_exception(error)

    Thread(target=run, daemon=True).start()
    return made.result(limit_s)


class _Loop:
    """Environments under an engine, and under controls that change every 5 steps. It has made one step."""

    def __init__(self, body: Any, engine: Any, num_envs: int) -> None:
        import jax
        import jax.numpy as jnp

        from core.physics.choose import engine_builder
        from core.physics.model import initial_qpos

        self._body, self._num_envs, model = body, num_envs, body.model
        built = engine_builder(engine)(model, body.num_substeps, body.derived, accelerated=body.solver)
        limited = model.actuator_ctrllimited.astype(bool)[:, None]
        low, high = jnp.where(limited, model.actuator_ctrlrange, jnp.array([-1.0, 1.0])).T
        move = jax.vmap(built.step)

        def run(states: Any, num_steps: int, key: jax.Array) -> Any:
            def step(states: Any, number: jax.Array) -> tuple[Any, None]:
                random = jax.random.uniform(jax.random.fold_in(key, number // 5), (num_envs, model.nu))
                return move(states, low + 0.5 * (1.0 + 0.6 * (random - 0.5)) * (high - low)), None

            return jax.lax.scan(step, states, jnp.arange(num_steps))[0]

        self._run: Any = jax.jit(run, static_argnums=1)
        self._key = jax.random.key(0)
        qpos = jnp.tile(jnp.asarray(initial_qpos(model), jnp.float32), (num_envs, 1))
        qvel = 0.1 * jax.random.normal(self._key, (num_envs, model.nv))
        self._states: Any = jax.jit(jax.vmap(built.reset))(qpos, qvel)
        self._move(1)

    def _move(self, num_steps: int, num_calls: int = 1) -> float:
        """The seconds of as many calls, which follow each other without the host."""
        import jax

        keys = jax.random.split(self._key, num_calls + 1)
        self._key = keys[0]
        began = time.perf_counter()
        for key in keys[1:]:
            self._states = self._run(self._states, num_steps, key)
        jax.block_until_ready(self._states)
        return time.perf_counter() - began

    def settle(self, steps: int) -> None:
        """At least a second of their time."""
        self._move(steps, -(-round(1.0 / self._body.control_s) // steps))

    def rate(self, steps: int, round_s: float) -> float:
        """Control steps per second of all environments, over calls that take about round_s."""
        once_s = self._move(steps)
        calls = round(round_s / once_s)
        seconds, calls = (self._move(steps, calls), calls) if calls > 1 else (once_s, 1)
        return self._num_envs * steps * calls / seconds

    def sound(self) -> float:
        import numpy as np

        return float(np.isfinite(np.asarray(self._states.qpos)).all(axis=1).mean())

    def contacts(self) -> float:
        """Of some environments, by C MuJoCo; a mean."""
        import mujoco
        import numpy as np

        model, counts = self._body.model, list[int]()
        data = mujoco.MjData(model)
        for qpos in np.asarray(self._states.qpos)[:_LOOKED_AT]:
            if np.isfinite(qpos).all():
                data.qpos[:] = qpos
                mujoco.mj_fwdPosition(model, data)
                counts.append(int(data.ncon))
        return float(np.mean(counts)) if counts else 0.0


if __name__ == "__main__":
    answer(work)
    os._exit(0)  # An engine's code may still be in the making.
