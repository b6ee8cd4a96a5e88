"""Seconds until an ant runs, on all cores of this machine; and the runs that such a bench is made of."""

from typing import Any

from bench.measure import requests
from bench.measure.marks import NUM_EPISODES, ON_A_CPU, Mark
from bench.measure.result import Options, Result
from bench.measure.runs import Runs, Work
from bench.measure.time_to_mark import Gate, figures, picture, rows, table
from bench.peers.published import PUBLISHED
from core.environments.info import Device

NOTES = [
    f"The mark is reached at the end of the first evaluation of {NUM_EPISODES} episodes that has it as its "
    "mean, if a second one from other starts has it, too. Marks were set before any tuning "
    "(bench/measure/marks.py). Seconds count from the call of the trainer, first evaluations included.",
    "Ours runs under the tuned settings of the catalog on the engine that `auto` takes, Brax's `ppo.train` "
    "under its published settings. Cold: nothing is compiled.",
]

# Brax's trainer takes minutes there; a single seed says enough.
_ANT = Gate(
    "ant",
    ON_A_CPU["ant"],
    every_steps=100_000,
    most_steps=3_000_000,
    peer_engine="native",
    job_steps=700_000,
    start_s=25,
    num_peers=1,
)


def measure(options: Options) -> Result:
    """One cold run of each trainer, then the seeds from a warm cache."""
    runs = Runs("gate", options)
    runs.make(works("cpu", _ANT, options))
    drawn = picture(_ANT, "gate", runs.done)
    return Result(
        name="gate",
        title="Seconds until an ant runs",
        command="./run bench gate",
        quick=options.quick,
        machine=runs.where(),
        figures=figures(_ANT, runs),
        table=table([_ANT], runs.done),
        rows=rows(runs.done),
        notes=[*NOTES, *runs.notes()],
        pictures=[drawn] if drawn else [],
        unfinished=runs.left,
    )


def works(device: Device, gate: Gate, options: Options) -> list[Work]:
    """Both trainers with nothing compiled, then every seed with what that left on disk, in turns."""
    body, seeds = requests.body(gate.body, options), options.seeds or (2 if options.quick else 5)

    requested = {"ours": _ours, "brax": _brax}
    modules = {"ours": "bench.ours.reach_mark", "brax": "bench.peers.reach_mark"}

    def work(who: str, seed: int, **more: Any) -> Work:
        return Work(
            f"{gate.body}-{who}-{'cold' if more.get('cold') else seed}",
            modules[who],
            requested[who](device, body, gate, options, seed),
            about_s=30 if who == "ours" else 200,
            cache=f"{who}-{gate.body}",
            **more,
        )

    cold = {who: work(who, 0, cold=True) for who in modules}
    found = list(cold.values())
    num_peers = min(seeds, gate.num_peers or seeds)
    for seed in range(seeds):
        runners = modules if seed < num_peers else ("ours",)
        pair = [work(who, seed, after=cold[who]) for who in runners]
        found += pair[:: -1 if seed % 2 else 1]
    if gate.job_steps is not None:
        request = {"device": device, "specification": _job(gate, body, options), "mark": _mark(gate, options)}
        found.append(Work(f"{gate.body}-job", "bench.ours.post_job", request, about_s=100))
    return found


def _job(gate: Gate, body: str, options: Options) -> dict[str, Any]:
    """A job with the tuned settings that ends soon after the mark."""
    steps = gate.job_steps or 0
    algorithm = {
        "num_timesteps": steps,
        "num_evals": steps // gate.every_steps,
        "num_eval_envs": NUM_EPISODES,
    }
    if options.quick:
        algorithm = {"num_timesteps": 5_120, "num_evals": 1, "num_eval_envs": 2, "episode_length": 20}
    video = {"seconds": 0.5} if options.quick else {}
    return {"kind": "train", "environment": body, "algorithm": algorithm, "video": video}


def _ours(device: Device, body: str, gate: Gate, options: Options, seed: int) -> dict[str, Any]:
    budget = {"num_timesteps": gate.most_steps, "num_evals": gate.most_steps // gate.every_steps}
    if gate.algorithm == "sac":
        given = requests.off_policy(options, **{"num_eval_envs": NUM_EPISODES, **budget})
        request = requests.ours(
            device, body, requests.engine(device, body, {}, quick=options.quick), given, seed=seed
        )
        return {**request, "mark": _mark(gate, options)}
    given = requests.settings(device, body, options, **budget)
    given["num_eval_envs"] = 2 if options.quick else NUM_EPISODES
    if options.quick:
        given = requests.whole_updates(device, body, {**given, "num_evals": 2}, 4)
    engine = requests.engine(device, body, given, quick=options.quick)
    request = requests.ours(device, body, engine, given, seed=seed)
    return {**request, "mark": _mark(gate, options)}


def _brax(device: Device, body: str, gate: Gate, options: Options, seed: int) -> dict[str, Any]:
    if options.quick:
        epochs, given = 2, requests.whole_updates(device, body, requests.settings(device, body, options), 4)
    else:
        # In whole updates, as Brax would round up the budget and every evaluation's share of it.
        published = PUBLISHED[gate.body]
        update = published["batch_size"] * published["num_minibatches"] * published["unroll_length"]
        between = max(1, (gate.peer_every_steps or gate.every_steps) // update) * update
        epochs = (gate.peer_most_steps or gate.most_steps) // between
        given = {**published, "num_timesteps": epochs * between}
    request = requests.brax(device, body, gate.peer_engine, given, seed=seed, epochs=epochs)
    limit = {"most_s": gate.peer_most_s} if gate.peer_most_s else {}
    return {**request, "mark": _mark(gate, options), **limit}


def _mark(gate: Gate, options: Options) -> dict[str, Any]:
    """One that everything reaches, if the bench is only tried out."""
    return Mark("eval/episode_reward", -1e9, "").in_request() if options.quick else gate.mark.in_request()
