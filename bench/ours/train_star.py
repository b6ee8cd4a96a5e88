"""One run of this project's Q-learning on a brittle star: `python -m bench.ours.train_star FOLDER`.

Request: options (of the environment `brittle_star`), settings (of the algorithm, if they differ from
the tuned ones), engine, device (`cpu` or `gpu`), seed; cache (a folder for compiled programs, or null);
steered (episodes in which the learnt table is tried afterwards, with unseen targets).
"""

import time
from typing import Any

from bench.measure.cache import keep_compiled
from bench.measure.child import answer

# Far from the seeds of runs.
_UNSEEN = 1_000_003


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[control steps, seconds of training until then], …]; rewards: [[control steps, mean return
    of the episodes since], …]; wall_s: from the environment's making to the last event; learnt_at: the hour
    of that; evaluation_s: of the wall, evaluating; phases: of it, seconds by name; control_steps: of all
    environments; episodes: made; greedy: each row's best column; reached: of the episodes afterwards, the
    share in which the target was reached; arrived_s: the mean of what those took."""

    from core.algorithms.catalog import resolve
    from core.algorithms.events import Evaluated, Phase, Progress
    from core.algorithms.q_learning.policy import read_policy
    from core.algorithms.q_learning.spec import QLearningSpec
    from core.algorithms.run import make_run
    from core.environments import catalog
    from core.physics.choose import engine_builder

    keep_compiled(request)
    began = time.perf_counter()
    row = catalog.find("brittle_star")
    options = catalog.parse_options(row, request["options"])
    environment = catalog.make(row, options, engine_builder(request["engine"]))
    spec = QLearningSpec.model_validate(request["settings"])
    settings = resolve(spec, row.under(options), request["device"])
    run = make_run(environment, settings, seed=request["seed"], checkpoint_every_steps=None)
    training, rewards, phases, evaluation_s = [], [], {}, 0.0
    for event in run.events():
        match event:
            case Phase(name=name, seconds=seconds):
                phases[name] = seconds
            case Progress(step=step, metrics=metrics):
                training.append((step, metrics["training/walltime"]))
                rewards.append((step, metrics["training/episode_reward"]))
            case Evaluated(metrics=metrics):
                evaluation_s += metrics["eval/epoch_eval_time"]
            case _:
                pass
    wall_s, learnt_at = time.perf_counter() - began, time.time()
    table = read_policy(run.policy()).table
    return {
        "training": training,
        "rewards": rewards,
        "phases": phases,
        "wall_s": wall_s,
        "learnt_at": learnt_at,
        "evaluation_s": evaluation_s,
        "control_steps": run.step,
        "episodes": settings.num_updates * settings.num_envs,
        "greedy": table.argmax(axis=1).tolist(),
        **(_steered(environment, settings, table, request["steered"]) if request["steered"] else {}),
    }


def _steered(environment: Any, settings: Any, table: Any, episodes: int) -> dict[str, float]:
    import jax
    import jax.numpy as jnp

    from core.algorithms.evaluation import run_episodes
    from core.algorithms.q_learning.discrete_env import DiscreteEnv, Tabular
    from core.algorithms.q_learning.table import greedy

    tabular = Tabular.of(settings.state_discretizer, settings.action_set, environment)
    totals = jax.device_get(
        jax.jit(
            lambda key: run_episodes(
                DiscreteEnv(environment, tabular, settings.decision_steps),
                lambda rows, _: (greedy(jnp.asarray(table), rows), ()),
                key,
                num_envs=episodes,
                episode_length=settings.decisions_per_episode,
            )
        )(jax.random.PRNGKey(_UNSEEN))
    )
    reached = (
        totals.metrics["target_reached"] * settings.decision_steps
    )  # Those of an action are means over its steps.
    seconds = totals.length * settings.decision_steps * environment.dt
    return {
        "reached": float(reached.mean()),
        "arrived_s": float((seconds * reached).sum() / max(1.0, reached.sum())),
    }


if __name__ == "__main__":
    answer(work)
