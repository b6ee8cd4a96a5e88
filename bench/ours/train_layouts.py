"""PPO in one corridor or many, then in corridors never seen: `python -m bench.ours.train_layouts FOLDER`.

Request: engine, device, settings (hyperparameters), seed, options (the corridor's, in training), tried (by
name, options that differ in a trial), episodes (in each trial), steps (the most in an episode); cache (a
folder for compiled programs, or null).
"""

import time
from functools import partial
from typing import Any

from bench.measure.cache import keep_compiled
from bench.measure.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[steps, seconds of training until then], …]; rewards: none; curriculum: the progress at
    those times, empty without one; tried: by the trial's name, see `trial`; wall_s: all of it."""
    from core.algorithms.catalog import resolve
    from core.algorithms.events import Progress
    from core.algorithms.policy import policy_from_checkpoint
    from core.algorithms.ppo.spec import PPOSpec
    from core.algorithms.run import make_run
    from core.environments import catalog
    from core.physics.choose import engine_builder

    keep_compiled(request)
    began, build = time.perf_counter(), engine_builder(request["engine"])

    def made(options: dict[str, Any]) -> Any:
        return catalog.make(*catalog.resolve("corridor", options), build)

    info, _ = catalog.resolve("corridor", request["options"])
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request["device"])
    run = make_run(made(request["options"]), settings, seed=request["seed"], checkpoint_every_steps=None)
    training, curriculum = list[tuple[int, float]](), list[float]()
    for event in run.events():
        if isinstance(event, Progress):
            training.append((event.step, event.metrics["training/walltime"]))
            curriculum += [event.metrics[name] for name in ("training/curriculum",) if name in event.metrics]
    policy = policy_from_checkpoint(run.checkpoint())
    try_in = partial(trial, policy, num_episodes=request["episodes"], num_steps=request["steps"])
    tried = {name: try_in(made({**request["options"], **own})) for name, own in request["tried"].items()}
    wall_s = time.perf_counter() - began
    return {"training": training, "rewards": [], "curriculum": curriculum, "tried": tried, "wall_s": wall_s}


def trial(policy: Any, environment: Any, *, num_episodes: int, num_steps: int) -> dict[str, float]:
    """speed: in m/s, over all steps until an episode's end, or its last gap; passed: the share of episodes
    that are past the last gap; halfway: the share that went half of the way there; way: the mean share of
    the way; fell: the share that the environment ended."""
    import jax
    import jax.numpy as jnp

    env, act = policy.acting(environment)

    def step(carry: Any, _: None) -> tuple[Any, None]:
        state, going, sums = carry
        keys = jax.random.split(jax.random.key(0), num_episodes)  # Without noise, they are not used.
        action = jax.vmap(act, (None, 0, 0))(policy.parameters, state, keys)
        state = jax.vmap(env.step)(state, action)
        seen = {name: state.metrics[name] for name in ("x_velocity", "success", "way_passed")}
        seen |= {"steps": jnp.ones(num_episodes), "fell": state.done}
        sums = {name: sums[name] + jnp.where(going, values, 0.0) for name, values in seen.items()}
        return (state, going & (state.done == 0) & (sums["success"] == 0), sums), None

    def whole(keys: Any) -> Any:
        nothing = dict.fromkeys(
            ("x_velocity", "success", "way_passed", "steps", "fell"), jnp.zeros(num_episodes)
        )
        begin = (jax.vmap(env.reset)(keys), jnp.ones(num_episodes, bool), nothing)
        return jax.lax.scan(step, begin, length=num_steps)[0][2]

    sums = jax.device_get(jax.jit(whole)(jax.random.split(jax.random.key(1), num_episodes)))
    return {
        "speed": float(sums["x_velocity"].sum() / sums["steps"].sum()),
        "passed": float(sums["success"].mean()),
        "halfway": float((sums["way_passed"] >= 0.5).mean()),
        "way": float(sums["way_passed"].mean()),
        "fell": float(sums["fell"].mean()),
    }


if __name__ == "__main__":
    answer(work)
