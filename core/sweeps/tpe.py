"""Optuna's samplers over our own records: a study in memory, made again for each draw.

Imported only where a sweep asks for it: Optuna loads NumPy. Raises Misconfigured without the extra `sweeps`.
"""

import hashlib
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pydantic import JsonValue

from core.errors import Misconfigured
from core.sweeps.advance import Seen
from core.sweeps.axes import Values, last_value, position
from core.sweeps.spec import Axis, Range, SweepSpec

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial

try:
    import optuna
except ModuleNotFoundError as error:
    raise Misconfigured(
        "The method `tpe` and the importance of parameters need Optuna where the reconciler runs: install "
        "the extra `sweeps` there."
    ) from error

# Random draws before the model of good and bad settings begins, as in Optuna.
_STARTUP_TRIALS = 10


def ask(spec: SweepSpec, number: int, seen: Sequence[Seen]) -> Values:
    """The values of trial `number`; the same records give the same values."""
    seed = int.from_bytes(hashlib.sha256(f"{spec.seed}/{number}".encode()).digest()[:4])
    with warnings.catch_warnings(category=optuna.exceptions.ExperimentalWarning, action="ignore"):
        sampler = optuna.samplers.TPESampler(
            seed=seed,
            n_startup_trials=_STARTUP_TRIALS,
            multivariate=True,
            # Trials that run count as bad ones, so that those side by side differ.
            constant_liar=True,
        )
    study = study_of(spec, seen, sampler)
    trial = study.ask(distributions(spec))
    return {name: _value(axis, trial.params[name]) for name, axis in spec.parameters.items()}


def study_of(spec: SweepSpec, seen: Sequence[Seen], sampler: Any = None) -> "Study":
    """The sweep's trials as a study."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(directions=[one.direction for one in spec.objectives], sampler=sampler)
    space = distributions(spec)
    for one in seen:
        study.add_trial(_frozen(spec, space, one))
    return study


def distributions(spec: SweepSpec) -> dict[str, "BaseDistribution"]:
    return {name: _distribution(axis) for name, axis in spec.parameters.items()}


def _distribution(axis: Axis) -> "BaseDistribution":
    if not isinstance(axis, Range):  # By position: Optuna takes no lists as choices.
        return optuna.distributions.CategoricalDistribution(range(len(axis)))
    high = last_value(axis)
    if axis.is_whole:
        step = 1 if axis.step is None else int(axis.step)
        return optuna.distributions.IntDistribution(int(axis.low), int(high), log=axis.log, step=step)
    return optuna.distributions.FloatDistribution(axis.low, high, log=axis.log, step=axis.step)


def _value(axis: Axis, drawn: Any) -> JsonValue:
    return drawn if isinstance(axis, Range) else axis[drawn]


def _internal(axis: Axis, value: JsonValue) -> Any:
    return value if isinstance(axis, Range) else position(axis, value)


def _frozen(spec: SweepSpec, space: dict[str, "BaseDistribution"], one: Seen) -> "FrozenTrial":
    trial, state = one.trial, optuna.trial.TrialState
    axes = spec.parameters
    said: dict[str, Any] = {"state": state.FAIL}
    if trial.outcome is None:
        said = {"state": state.RUNNING}
    elif trial.outcome == "pruned":
        curve = one.curve or {trial.steps: trial.values[0]} if trial.has_values else {}
        said = {"state": state.PRUNED, "intermediate_values": dict(curve)}
    elif trial.outcome == "succeeded" and trial.has_values:
        said = {"state": state.COMPLETE, "values": list(trial.values)}
    return optuna.trial.create_trial(
        params={name: _internal(axis, trial.parameters[name]) for name, axis in axes.items()},
        distributions=space,
        **said,
    )
