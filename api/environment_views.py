"""The documents of environments and algorithms, made of their rows in the catalog."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, get_args

from api.views import Answer
from core.algorithms.catalog import ALGORITHMS, environment_options, resolve, tuned
from core.environments.info import Device, EnvironmentInfo
from core.errors import Rejected
from core.rendering.camera import TRACK
from core.sweeps.results import metrics_of
from gaitway.schema import EnvironmentDetails, EnvironmentView, SliceView


class AlgorithmView(Answer):
    """An algorithm, and the JSON Schema of its hyperparameters."""

    kind: str
    description: str
    parameters: dict[str, Any]


def environment_view(info: EnvironmentInfo) -> EnvironmentView:
    return EnvironmentView(**_facts(info))


def environment_details(info: EnvironmentInfo) -> EnvironmentDetails:
    return EnvironmentDetails(
        **_facts(info),
        observation=tuple(SliceView.model_validate(one) for one in info.spaces.observation),
        action=tuple(SliceView.model_validate(one) for one in info.spaces.action),
        defaults=_by_algorithm_and_device(lambda kind, device: _defaults(kind, info, device)),
        metrics={kind or "rollout": tuple(sorted(metrics_of(info.id, kind))) for kind in (*ALGORITHMS, None)},
    )


def _facts(info: EnvironmentInfo) -> dict[str, Any]:
    return {
        "id": info.id,
        "family": info.family,
        "description": info.description,
        "observation_size": info.observation_size,
        "action_size": info.action_size,
        "dt": info.dt,
        "episode_length": info.episode_length,
        "cameras": (TRACK, *(name for name in info.cameras if name and name != TRACK)),
        "options": info.options.model_json_schema(),
        "tuned": _by_algorithm_and_device(lambda kind, device: tuned(kind, _row_for(kind, info), device)),
        "environment_options": {kind: taken for kind in ALGORITHMS if (taken := _taken(kind, info))},
        "cannot_run": info.cannot_run,
    }


def _by_algorithm_and_device(
    values: Callable[[str, Device], dict[str, Any]],
) -> dict[str, dict[str, dict[str, Any]]]:
    """Without the algorithms and devices for which there are no values."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
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
