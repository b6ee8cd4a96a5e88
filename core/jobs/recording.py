"""Whether a rollout can record what it asks for: which layers its policy has, and how large the file is."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from core.algorithms.catalog import ALGORITHMS, reported
from core.environments.info import POLICY_GROUP, EnvironmentInfo
from core.errors import Problem, Rejected
from core.jobs.job import Job
from core.jobs.spec import RolloutSpec
from core.patterns import matching

MOST_BYTES = 4 * 10**9
_NUMBER_BYTES = 4
_LAYERS = "/recording/layers"


def chosen_layers(patterns: Sequence[str] | None, layers: Sequence[str]) -> list[str]:
    """The layers to record, in their own order. patterns: None: all. Raises Rejected if one matches none."""
    if patterns is None:
        return [*layers]
    there = f"It has {', '.join(layers)}." if layers else "It has none."
    problems = [
        Problem(f"{_LAYERS}/{number}", f"No layer of the policy is called {pattern!r}. {there}")
        for number, pattern in enumerate(patterns)
        if not matching([pattern], layers)
    ]
    if problems:
        raise Rejected(problems[0].detail, problems)
    return matching(patterns, layers)


def check_recording(spec: RolloutSpec, info: EnvironmentInfo, get: Callable[[str], Job]) -> None:
    """Refuse layers that the policy lacks, and a file that is too large, where that is known.

    info: of the environment under the job's options. get: the job of an id. Raises Rejected.
    """
    if spec.recording is None:
        return
    layers = _layers(spec, info, get)
    names = None if layers is None else chosen_layers(spec.recording.layers, list(layers))
    sizes = [] if layers is None or names is None else [layers[name] for name in names]
    numbers = sum(sizes) + (info.observation_size or 0) + (info.action_size or 0)
    numbers += 3 * len(info.names.get("body", ()))
    steps = spec.num_steps * spec.num_episodes
    if (size := _NUMBER_BYTES * numbers * steps) > MOST_BYTES:
        detail = (
            f"The recording would have about {size / 1e9:.1f} GB: {steps:,} steps of {numbers:,} numbers. At "
            f"most {MOST_BYTES / 1e9:g} GB are allowed: record fewer layers, steps or episodes."
        )
        places = (_LAYERS, "/num_steps", "/num_episodes")
        raise Rejected(detail, [Problem(place, detail) for place in places])


def _layers(spec: RolloutSpec, info: EnvironmentInfo, get: Callable[[str], Job]) -> Mapping[str, int] | None:
    """The sizes of the policy's layers by name; None where the record does not tell.

    Raises Rejected where layers are asked of a policy that has none, or that sees what is not recorded.
    """
    source = spec.source
    if source is None:
        return _none_of(spec, f"a policy of the kind `{spec.policy.kind}` has none")
    used: list[Any] = [one.details.get("hyperparameters") for one in get(source.job).attempts]
    if not any(used):
        return None
    settings = reported([one for one in used if one][-1])
    kind = settings.algorithm()
    if not (layers := ALGORITHMS[kind].layers(settings, info.action_size or 0)):
        return _none_of(spec, f"those of a policy of {kind} cannot be recorded")
    seen = getattr(settings, "policy_obs_key", POLICY_GROUP)
    if len(info.observations) > 1 and seen != POLICY_GROUP:
        return _none_of(spec, f"the policy sees {seen!r}, which rollouts do not keep")
    return layers


def _none_of(spec: RolloutSpec, why: str) -> Mapping[str, int]:
    if spec.recording is not None and spec.recording.layers is not None:
        detail = f"The recording asks for layers, but {why}: leave `layers` out."
        raise Rejected(detail, [Problem(_LAYERS, detail)])
    return {}
