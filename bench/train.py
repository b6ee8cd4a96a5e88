"""Training: its rate, the seconds until a body moves well, seeds, robots, and a job's way; beside Brax.

A mark is reached at the end of the first evaluation of 128 episodes that has it as its mean, if a second one
from other starts has it, too. Seconds count from the call of the trainer, evaluations included. Ours trains
under the catalog's tuned settings on the engine that `auto` takes, Brax under its published ones. Cold:
nothing is compiled; warm: with what the cold run left on disk. The robots are those of `bench.robots`.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from bench import robots
from bench.child import ChildFailed, run_child
from bench.peers.published import PUBLISHED
from bench.stack import running_stack
from bench.summary import Figure, middle
from core.algorithms.catalog import resolve
from core.algorithms.ppo.spec import PPOSpec
from core.environments import catalog
from core.environments.info import Device
from gaitway.client import Client

PARTS = ("rate", "mark", "seeds", "robots", "job")
_OURS, _BRAX = "bench.children.train_ours", "bench.children.train_brax"
_EPISODES = 128
# Brax has no learning rate that falls along a line, which costs no time.
_AS_BRAX = {"learning_rate_schedule": "NONE"}
_EPOCHS = 4
_TIMEOUT_S = 900.0

Answer = dict[str, Any]


@dataclass(frozen=True)
class Mark:
    """At least `least` of this metric of an evaluation. Marks were set before any tuning, and never moved.

    On a GPU, they are the returns of Brax's trainer at the end of its budget, means of three seeds; on a CPU
    it is a speed in m/s at which the ant plainly runs.
    """

    least: float
    metric: str = "eval/episode_reward"


@dataclass(frozen=True)
class Gate:
    """A body's way to its mark. every_steps, peer_every_steps: from one evaluation to the next; most_steps:
    of the budgets; warm_s, times: targets, in seconds and in times as fast as Brax; num_peers: Brax's seeds;
    peer_most_s: after which its run is cut off."""

    body: str
    mark: Mark
    every_steps: int
    most_steps: int
    peer_engine: str
    algorithm: str = "ppo"
    warm_s: float | None = None
    times: float | None = None
    num_peers: int = 1
    peer_every_steps: int = 3_000_000
    peer_most_s: float | None = None


@dataclass(frozen=True)
class Rate:
    """A training whose rate is measured. peer: the engine of Brax's trainer under the same settings."""

    name: str
    body: str
    settings: Answer
    options: Answer = field(default_factory=dict[str, Any])
    engine: str = "auto"
    peer: str | None = None


_GATES: dict[Device, list[Gate]] = {
    "cpu": [
        Gate("ant", Mark(1.4, "eval/forward_speed"), 100_000, 3_000_000, "native", peer_every_steps=100_000)
    ],
    "gpu": [
        Gate("ant", Mark(3459), 1_000_000, 40_000_000, "mjx", warm_s=10, times=6, num_peers=2),
        Gate("humanoid", Mark(7130), 2_000_000, 50_000_000, "mjx", warm_s=20),
        Gate("half_cheetah", Mark(4771), 2_000_000, 50_000_000, "mjx", times=5, peer_most_s=75),
        Gate("hopper", Mark(762), 2_000_000, 50_000_000, "mjx", times=5, peer_most_s=36),
        Gate("walker2d", Mark(4515), 250_000, 5_000_000, "mjx", "sac", times=5, peer_most_s=90),
    ],
}
_TOGETHER, _TOGETHER_STEPS = 16, {"cpu": 500_000, "gpu": 20_000_000}
_STAR = {"control": "cpg"}
_RATES: dict[Device, list[Rate]] = {
    "cpu": [
        Rate("PPO, ant", "ant", {"kind": "ppo", "num_timesteps": 491_520}),
        Rate(
            "PPO, ant on `native`", "ant", {"kind": "ppo", "num_timesteps": 491_520}, {}, "native", "native"
        ),
        Rate("SAC, walker2d", "walker2d", {"kind": "sac", "num_timesteps": 60_000}),
        Rate("Q-learning, brittle star", "brittle_star", {"kind": "q_learning"}, _STAR),
    ],
    "gpu": [
        Rate("PPO, ant", "ant", {"kind": "ppo", **PUBLISHED["ant"], "num_timesteps": 30_000_000}, peer="mjx"),
        Rate("SAC, humanoid", "humanoid", {"kind": "sac", "num_timesteps": 4_000_000}),
        Rate("Q-learning, brittle star", "brittle_star", {"kind": "q_learning"}, _STAR),
    ],
}
_JOB_STEPS: dict[Device, int] = {"cpu": 700_000, "gpu": 10_000_000}
_VIDEO_S: dict[Device, float | None] = {"cpu": None, "gpu": 20}
# To try out the bench: a body that compiles fast, a small budget, and a mark that everything reaches.
_QUICK_BODY = "inverted_pendulum"
_QUICK: Answer = {"num_eval_envs": 2, "episode_length": 20, "num_timesteps": 5_120, "num_evals": 2}
_QUICK_PPO: Answer = {"num_envs": 8, "batch_size": 8, "num_minibatches": 2, "unroll_length": 5, **_QUICK}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all by default")
    parser.add_argument("--gpu", action="store_true", help="on the first GPU, not on all cores")
    parser.add_argument(
        "--bodies", nargs="+", metavar="BODY", help="of the parts `mark` and `robots`; by default all"
    )
    parser.add_argument(
        "--seeds", type=int, default=5, metavar="N", help="of ours, in the parts `mark`, `robots`"
    )
    parser.add_argument("--without-brax", action="store_true", help="measure ours alone")
    robots.add_arguments(parser)


def measure(arguments: argparse.Namespace) -> list[Figure]:
    """The parts that were named, or all."""
    if unknown := set(arguments.parts) - set(PARTS):
        raise SystemExit(f"There is no part {unknown.pop()!r} of the bench `train`.")
    device: Device = "gpu" if arguments.gpu else "cpu"
    measured = {"rate": _rates, "mark": _marks, "seeds": _seeds, "robots": _robots, "job": _job}
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        return [
            figure
            for part in arguments.parts or PARTS
            for figure in measured[part](device, Path(folder), arguments)
        ]


def rate(training: Sequence[Sequence[float]]) -> float:
    """Steps per second over the second half of [steps, seconds so far], or since the last report but one.

    The first report's seconds include compiling. Raises ValueError if there is no other report.
    """
    if len(training) < 2:
        raise ValueError("One point has no second half: the run reported only once.")
    end_step, end_s = training[-1]
    half_step, half_s = next((point for point in training[:-1] if 2 * point[0] >= end_step), training[-2])
    return (end_step - half_step) / (end_s - half_s)


def _rates(device: Device, folder: Path, arguments: argparse.Namespace) -> Iterator[Figure]:
    wanted = _RATES[device]
    if arguments.quick:
        wanted = [Rate("PPO", _QUICK_BODY, {"kind": "ppo", **_QUICK_PPO}, engine="native", peer="native")]
    for one in wanted:
        request = {
            "environment": one.body,
            "options": one.options,
            "engine": one.engine,
            "settings": one.settings,
            "seed": 0,
            "device": device,
            "mark": None,
        }
        if one.settings["kind"] == "ppo":
            request["settings"] = {**one.settings, "num_evals": 0, **_whole(one, device)}
        ours = _answer(_OURS, request, folder)
        yield _rate(one.name, ours)
        if one.peer and not arguments.without_brax:
            settings = {**request["settings"], **_AS_BRAX}
            told = {
                "engine": one.peer,
                "settings": settings,
                "epochs": _EPOCHS,
                "episodes": 2,
                "most_s": None,
            }
            theirs = _answer(_BRAX, {**request, **told}, folder)
            yield _rate(f"{one.name}, Brax on `{one.peer}`", theirs)
            if isinstance(ours, dict) and isinstance(theirs, dict):
                yield Figure(
                    f"{one.name}: ours ÷ Brax", rate(ours["training"]) / rate(theirs["training"]), "×"
                )


def _whole(one: Rate, device: Device) -> Answer:
    """A budget that both trainers spend exactly: Brax rounds each epoch up to whole updates."""
    spec = resolve(PPOSpec.model_validate(one.settings), catalog.find(one.body), device)
    quantum = _EPOCHS * spec.env_steps_per_update
    return {"num_timesteps": -(-spec.num_timesteps // quantum) * quantum}


def _rate(name: str, answered: Answer | str) -> Figure:
    unit = "training steps/s"
    if isinstance(answered, str):
        return Figure(name, None, unit, missing=answered)
    return Figure(name, rate(answered["training"]), unit)


def _answer(module: str, request: Answer, cache: Path) -> Answer | str:
    """The child's answer, or the reason why there is none."""
    cache.mkdir(exist_ok=True)
    try:
        return run_child(module, {**request, "cache": str(cache)}, timeout_s=_TIMEOUT_S)
    except ChildFailed as failure:
        print(failure)
        return failure.reason


def _marks(device: Device, folder: Path, arguments: argparse.Namespace) -> Iterator[Figure]:
    gates = [gate for gate in _GATES[device] if not arguments.bodies or gate.body in arguments.bodies]
    seeds = arguments.seeds
    if arguments.quick:
        gates = [replace(gates[0], body=_QUICK_BODY, mark=Mark(-1e9), every_steps=2560, most_steps=5120)]
        seeds = 1
    for gate in gates:
        ours = [_ours(gate, seed, device, folder, arguments) for seed in (0, *range(seeds))]
        yield from _figures(gate, "ours", ours, arguments.quick)
        if arguments.without_brax:
            continue
        brax = [_brax(gate, seed, device, folder, arguments) for seed in (0, *range(gate.num_peers))]
        yield from _figures(gate, "Brax", brax, quick=True)
        own, peers = _reached(ours[1:]), [one for one in brax[1:] if isinstance(one, dict)]
        if own and peers:
            # Where Brax did not come there, it is counted with the time that it was given.
            theirs = [one["reached_s"] or one["curve"][-1][2] for one in peers]
            least = any(one["reached_s"] is None for one in peers)
            name = f"{gate.body}, warm: Brax ÷ ours{', at least' if least else ''}"
            times = middle("", theirs).value or 0.0
            target = None if arguments.quick else gate.times
            yield Figure(name, times / (middle("", own).value or 1.0), "×", at_least=target)


def _ours(gate: Gate, seed: int, device: Device, folder: Path, arguments: argparse.Namespace) -> Answer | str:
    num_evals = gate.most_steps // gate.every_steps
    budget = {"num_timesteps": gate.most_steps, "num_evals": num_evals, "num_eval_envs": _EPISODES}
    request = {
        "environment": gate.body,
        "options": {},
        "engine": "auto",
        "settings": {"kind": gate.algorithm, **(_QUICK_PPO if arguments.quick else budget)},
        "seed": seed,
        "device": device,
        "mark": asdict(gate.mark),
    }
    return _answer(_OURS, request, folder / f"{gate.body}-ours")


def _brax(gate: Gate, seed: int, device: Device, folder: Path, arguments: argparse.Namespace) -> Answer | str:
    settings, epochs = {**_QUICK_PPO, **_AS_BRAX}, 2
    if not arguments.quick:
        settings = PUBLISHED[gate.body]
        update = settings["batch_size"] * settings["num_minibatches"] * settings["unroll_length"]
        # In whole updates, as Brax would round up every evaluation's share of the budget.
        between = max(1, gate.peer_every_steps // update) * update
        epochs = min(gate.most_steps, 40_000_000) // between
        settings = {**settings, "num_timesteps": epochs * between}
    request = {
        "environment": gate.body,
        "engine": gate.peer_engine,
        "settings": settings,
        "seed": seed,
        "device": device,
        "mark": asdict(gate.mark),
        "epochs": epochs,
        "episodes": 2 if arguments.quick else _EPISODES,
        "most_s": gate.peer_most_s,
    }
    return _answer(_BRAX, request, folder / f"{gate.body}-brax")


def _reached(answers: Sequence[Answer | str]) -> list[float]:
    """Seconds to the mark; none at all if one run did not come there."""
    found = [one["reached_s"] for one in answers if isinstance(one, dict)]
    return [] if len(found) < len(answers) or None in found else found


def _figures(gate: Gate, who: str, answers: Sequence[Answer | str], quick: bool) -> Iterator[Figure]:
    """The first answer is of a run with nothing compiled, the others are of the seeds after it."""
    cold, *warm = answers
    reasons = [one for one in answers if isinstance(one, str)]
    missing = reasons[0] if reasons else "a run did not reach the mark"
    name, target = f"{gate.body} to {gate.mark.least:g}, {who}", None if quick else gate.warm_s
    there = _reached(warm)
    yield middle(f"{name}, warm, {len(warm)} seeds", there, "s", at_most=target, missing=missing)
    yield middle(f"{name}, cold", _reached([cold]), "s", missing=missing)
    if who == "ours" and there:
        worst = max(there) / (middle("", there).value or 1.0)
        yield Figure(f"{name}: the worst seed ÷ the median", worst, "×", at_most=1.5)
        whole = [one["reached_at"] - one["began_at"] for one in warm if isinstance(one, dict)]
        yield Figure(f"{name}, warm, from the process's start, worst seed", max(whole), "s")


def _seeds(device: Device, folder: Path, arguments: argparse.Namespace) -> Iterator[Figure]:
    """Ants in one program, and one alone: the seconds of a training, compiling (cold) and without (warm)."""
    budget: Answer = {"num_timesteps": _TOGETHER_STEPS[device], "num_evals": 4, "num_eval_envs": _EPISODES}
    request = {
        "environment": _QUICK_BODY if arguments.quick else "ant",
        "options": {},
        "engine": "auto",
        "settings": {"kind": "ppo", **(_QUICK_PPO if arguments.quick else budget)},
        "device": device,
        "mark": None,
    }
    number = 2 if arguments.quick else _TOGETHER
    for which in ("cold", "warm"):
        took = [_answer(_OURS, {**request, "seed": seed}, folder / "seeds") for seed in (0, [*range(number)])]
        alone, together = (one["ended_s"] if isinstance(one, dict) else None for one in took)
        missing = next((one for one in took if isinstance(one, str)), "")
        times = together / alone if alone and together else None
        yield Figure(f"one seed alone, {which}", alone, "s", missing=missing)
        most = 3.0 if which == "warm" and device == "gpu" and not arguments.quick else None
        yield Figure(
            f"{number} seeds together ÷ one alone, {which}", times, "×", at_most=most, missing=missing
        )


def _robots(_: Device, folder: Path, arguments: argparse.Namespace) -> Iterator[Figure]:
    """Robots that walk by command, until they pass their battery."""
    yield from robots.measure(arguments, folder)


def _job(device: Device, folder: Path, arguments: argparse.Namespace) -> Iterator[Figure]:
    """A job that is sent to a service of its own, twice: with nothing compiled, and with what that left."""
    [gate, *_], steps = _GATES[device], _JOB_STEPS[device]
    algorithm = {"num_timesteps": steps, "num_evals": steps // gate.every_steps, "num_eval_envs": _EPISODES}
    job: Answer = {"kind": "train", "environment": gate.body, "algorithm": algorithm}
    if arguments.quick:
        job = {"kind": "train", "environment": _QUICK_BODY, "algorithm": _QUICK, "video": {"seconds": 0.5}}
        gate = replace(gate, body=_QUICK_BODY, mark=Mark(-1e9))
    job["resources"] = {"accelerator": device}
    with running_stack(folder / "service") as stack, Client(stack.url) as client:
        for which in ("cold", "warm"):
            for what, seconds in _followed(client, job, gate.mark).items():
                target = _VIDEO_S[device] if (which, what) == ("warm", "video") else None
                name = f"{gate.body}, from the submission to the {what}, {which}"
                yield Figure(name, seconds, "s", at_most=target, missing="it did not come")


def _followed(client: Client, job: Answer, mark: Mark) -> dict[str, float | None]:
    """Seconds from the submission to the mark and to the video. Raises RuntimeError if the job fails."""
    found: dict[str, float | None] = {"mark": None, "video": None}
    submitted = time.time()
    sent = client.submit(job)
    for event in client.events(sent.id):
        seconds = event.time.timestamp() - submitted if event.time else 0.0
        match event.kind:
            case "metrics" if event.data["values"].get(mark.metric, -1e30) >= mark.least:
                found["mark"] = found["mark"] or seconds
            case "artifact" if event.data["role"] == "video":
                found["video"] = seconds
            case _:
                pass
    if not (ended := client.get(sent.id)).succeeded:
        raise RuntimeError(f"Job {sent.id} {ended.status}: {ended.message}")
    return found
