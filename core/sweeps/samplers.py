"""The draws of Optuna's samplers, and of Sobol's sequence, over our own records.

A study in memory is made again from the records for each draw, so nothing is lost with a process.
Imported only where a sweep asks for it: Optuna loads NumPy. Raises Misconfigured without the extra `sweeps`.
"""

import hashlib
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pydantic import JsonValue

from core.errors import Misconfigured
from core.sweeps.axes import Values, last_value, position, value_at
from core.sweeps.spec import Axis, Range, SweepSpec
from core.sweeps.sweep import SeenTrial, Trial

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.samplers import BaseSampler
    from optuna.trial import FrozenTrial

try:
    import cmaes as cmaes  # Optuna imports it at a draw.
    import optuna
except ModuleNotFoundError as error:
    raise Misconfigured(
        "The methods `qmc`, `tpe`, `cma_es` and `nsga2` and the importance of parameters need Optuna where "
        "the reconciler runs: install the extra `sweeps` there."
    ) from error


class _Positions(optuna.distributions.CategoricalDistribution):
    """The distribution of the positions in a list of values.

    Optuna compares and copies the distribution of each axis for each trial, one choice after another: with
    1,000 trials along lists of 1,000 values that took a minute.
    """

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Positions) and len(other.choices) == len(self.choices)

    __hash__ = optuna.distributions.CategoricalDistribution.__hash__

    def __deepcopy__(self, memo: object) -> "_Positions":
        return self

    def to_internal_repr(self, param_value_in_external_repr: Any) -> float:
        return int(param_value_in_external_repr)


# Random draws before the model of good and bad settings begins, as in Optuna.
_STARTUP_TRIALS = 10
# NSGA-II's population: Optuna's 50 would leave most sweeps in their first generation, which is random.
_POPULATION = 20


def ask(spec: SweepSpec, number: int, seen: Sequence[SeenTrial]) -> Values:
    """The values of trial `number`; the same records give the same values."""
    if spec.method == "qmc":
        return _sobol(spec, number)
    seed = int.from_bytes(hashlib.sha256(f"{spec.seed}/{number}".encode()).digest()[:4])
    with warnings.catch_warnings(category=optuna.exceptions.ExperimentalWarning, action="ignore"):
        match spec.method:
            case "cma_es":
                study = _told(spec, seen, optuna.samplers.CmaEsSampler(seed=seed))
            case "nsga2":
                sampler = optuna.samplers.NSGAIISampler(population_size=_POPULATION, seed=seed)
                study = _told(spec, seen, sampler)
            case _:
                # Trials that run count as bad ones, so that those side by side differ.
                sampler = optuna.samplers.TPESampler(
                    seed=seed, n_startup_trials=_STARTUP_TRIALS, multivariate=True, constant_liar=True
                )
                study = study_of(spec, seen, sampler)
    trial = study.ask(distributions(spec))
    return {name: _value(axis, trial.params[name]) for name, axis in spec.parameters.items()}


def _sobol(spec: SweepSpec, number: int) -> Values:
    """Point `number` of Sobol's sequence, scrambled by the sweep's seed, along all axes.

    SciPy's, which Optuna's QMCSampler takes, too; but that one draws from lists at random, and counts its
    points in its storage.
    """
    from scipy.stats import qmc

    points: Any = qmc.Sobol(len(spec.parameters), rng=spec.seed)
    if number:
        points.fast_forward(number)
    (point,) = points.random(1)
    axes = zip(spec.parameters.items(), point, strict=True)
    return {name: value_at(axis, float(share)) for (name, axis), share in axes}


def _told(spec: SweepSpec, seen: Sequence[SeenTrial], sampler: "BaseSampler") -> "Study":
    """A study that asked for each trial that has values, in the order of their ends, and was told these.

    Asked so, CMA-ES and NSGA-II note the generation that each trial belongs to.
    """
    study = study_of(spec, (), sampler)
    space = distributions(spec)
    ended = [one.trial for one in seen if one.trial.outcome == "succeeded" and one.trial.has_values]
    for trial in sorted(ended, key=lambda one: (one.finished_at or one.created_at, one.number)):
        study.enqueue_trial(_params(spec, trial))
        asked = study.ask(space)
        _ = asked.relative_params  # Otherwise the sampler is not asked, as all values are given.
        study.tell(asked, [value for value in trial.values if value is not None])
    return study


def study_of(spec: SweepSpec, seen: Sequence[SeenTrial], sampler: Any = None) -> "Study":
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
        return _Positions(range(len(axis)))
    high = last_value(axis)
    if axis.is_whole:
        step = 1 if axis.step is None else int(axis.step)
        return optuna.distributions.IntDistribution(int(axis.low), int(high), log=axis.log, step=step)
    return optuna.distributions.FloatDistribution(axis.low, high, log=axis.log, step=axis.step)


def _value(axis: Axis, drawn: Any) -> JsonValue:
    return drawn if isinstance(axis, Range) else axis[drawn]


def _params(spec: SweepSpec, trial: Trial) -> dict[str, Any]:
    """Its values as Optuna has them: of a list, the position."""
    values = trial.parameters
    return {
        name: values[name] if isinstance(axis, Range) else position(axis, values[name])
        for name, axis in spec.parameters.items()
    }


def _frozen(spec: SweepSpec, space: dict[str, "BaseDistribution"], one: SeenTrial) -> "FrozenTrial":
    trial, state = one.trial, optuna.trial.TrialState
    state_fields: dict[str, Any] = {"state": state.FAIL}
    if trial.outcome is None:
        state_fields = {"state": state.RUNNING}
    elif trial.outcome == "pruned":
        curve = one.curve or {trial.steps: trial.values[0]} if trial.has_values else {}
        state_fields = {"state": state.PRUNED, "intermediate_values": dict(curve)}
    elif trial.outcome == "succeeded" and trial.has_values:
        state_fields = {"state": state.COMPLETE, "values": list(trial.values)}
    return optuna.trial.create_trial(
        params=_params(spec, trial),
        distributions=space,
        **state_fields,
    )
