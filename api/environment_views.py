"""Environments and algorithms as clients see them."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Self, get_args

from api.views import View
from core.algorithms.catalog import ALGORITHMS, environment_options, resolve, tuned
from core.environments.info import Device, EnvironmentInfo
from core.environments.spaces import Slice
from core.errors import Rejected
from core.physics.availability import EngineName
from core.rendering.camera import TRACK
from core.sweeps.metrics import metrics_of


class EnvironmentView(View):
    """An environment. dt: seconds between actions; options: their JSON Schema.

    tuned: hyperparameters that fit it, by algorithm and device. environment_options: by algorithm, the
    options that a job takes where it leaves them out, because `tuned` is made for them. family: `gaitway`, or
    the package that provides it. cannot_run: engines that cannot run it, each with the reason.
    Sizes and dt are null where they depend on the model that the options name.
    """

    id: str
    family: str
    description: str
    observation_size: int | None
    action_size: int | None
    dt: float | None
    episode_length: int
    cameras: Sequence[str]
    options: dict[str, Any]
    tuned: Mapping[str, Mapping[Device, Mapping[str, Any]]]
    environment_options: Mapping[str, Mapping[str, Any]]
    cannot_run: Mapping[EngineName, str]

    @classmethod
    def of(cls, info: EnvironmentInfo) -> Self:
        return cls(
            id=info.id,
            family=info.family,
            description=info.description,
            observation_size=info.observation_size,
            action_size=info.action_size,
            dt=info.dt,
            episode_length=info.episode_length,
            cameras=[TRACK, *(name for name in info.cameras if name and name != TRACK)],
            options=info.options.model_json_schema(),
            tuned=_by_algorithm_and_device(lambda kind, device: tuned(kind, _row_for(kind, info), device)),
            environment_options={kind: taken for kind in ALGORITHMS if (taken := _taken(kind, info))},
            cannot_run=info.cannot_run,
        )


class EnvironmentDetails(EnvironmentView):
    """An environment under the given options, and what a job on it gets by default.

    defaults: every hyperparameter of a job that sets none, by algorithm and device. An algorithm that needs
    more than its defaults on this environment is left out.
    observation, action: their numbers in order, with units and bounds; empty where they depend on a model
    that the options do not name.
    metrics: what a job reports, by algorithm and for `rollout`; without the terms of a reward that depend on
    options, `eval/episode_…`.
    """

    observation: Sequence[Slice]
    action: Sequence[Slice]
    defaults: Mapping[str, Mapping[Device, Mapping[str, Any]]]
    metrics: Mapping[str, Sequence[str]]

    @classmethod
    def of(cls, info: EnvironmentInfo) -> Self:
        shown = EnvironmentView.of(info)
        return cls(
            **{name: getattr(shown, name) for name in EnvironmentView.model_fields},
            observation=info.spaces.observation,
            action=info.spaces.action,
            defaults=_by_algorithm_and_device(lambda kind, device: _defaults(kind, info, device)),
            metrics={kind or "rollout": sorted(metrics_of(info.id, kind)) for kind in (*ALGORITHMS, None)},
        )


class AlgorithmView(View):
    """An algorithm, and the JSON Schema of its hyperparameters."""

    kind: str
    description: str
    parameters: dict[str, Any]


def _by_algorithm_and_device(
    values: Callable[[str, Device], dict[str, Any]],
) -> dict[str, dict[Device, dict[str, Any]]]:
    """Without the algorithms and devices for which there are no values."""
    found: dict[str, dict[Device, dict[str, Any]]] = {}
    for kind in ALGORITHMS:
        for device in get_args(Device):
            if own := values(kind, device):
                found.setdefault(kind, {})[device] = own
    return found


def _taken(kind: str, info: EnvironmentInfo) -> Mapping[str, Any]:
    """Options that a job on the environment takes because neither it nor these options say them."""
    if info.takes_model:
        return {}
    return environment_options(
        ALGORITHMS[kind].spec(), info.id, info.option_values.model_dump(exclude_unset=True)
    )


def _row_for(kind: str, info: EnvironmentInfo) -> EnvironmentInfo:
    """The environment as a job with this algorithm gets it."""
    if not (taken := _taken(kind, info)):
        return info
    given = info.option_values.model_dump(exclude_unset=True)
    return info.under(info.options.model_validate({**given, **taken}))


def _defaults(kind: str, info: EnvironmentInfo, device: Device) -> dict[str, Any]:
    """Every hyperparameter; none where the algorithm needs more than its defaults."""
    with suppress(Rejected):
        return resolve(ALGORITHMS[kind].spec(), _row_for(kind, info), device).model_dump(mode="json")
    return {}
