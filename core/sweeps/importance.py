"""The share of each axis in what makes trials differ, by PED-ANOVA (Watanabe et al., 2023) in Optuna."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

from core.errors import Misconfigured
from core.sweeps.spec import SweepSpec
from core.sweeps.sweep import SeenTrial

_LEAST_TRIALS = 4


def importance(
    spec: SweepSpec, seen: Sequence[SeenTrial]
) -> tuple[Mapping[str, Mapping[str, float]] | None, str | None]:
    """By objective and axis; or None, and why: a sentence."""
    if spec.population is not None:
        return None, "The method `pbt` changes settings while a run trains, so no setting has a result alone."
    succeeded = [one for one in seen if one.trial.outcome == "succeeded" and one.trial.has_values]
    if len(succeeded) < _LEAST_TRIALS:
        return None, f"It needs {_LEAST_TRIALS} trials that succeeded, and has {len(succeeded)}."
    for at, objective in enumerate(spec.objectives):
        if len({one.trial.values[at] for one in succeeded}) == 1:
            return None, f"All trials have the same {objective.metric}."
    try:
        return _by_ped_anova(spec, succeeded), None
    except Misconfigured as error:
        return None, error.detail


def _by_ped_anova(spec: SweepSpec, succeeded: Sequence[SeenTrial]) -> Mapping[str, Mapping[str, float]]:
    from core.sweeps import samplers

    optuna = samplers.optuna
    with warnings.catch_warnings(category=optuna.exceptions.ExperimentalWarning, action="ignore"):
        evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    found: dict[str, dict[str, float]] = {}
    for at, objective in enumerate(spec.objectives):
        alone = spec.model_copy(update={"objective": objective})
        study = samplers.study_of(alone, [_with_one_value(one, at) for one in succeeded])
        shares = optuna.importance.get_param_importances(study, evaluator=evaluator)
        found[objective.metric] = {name: float(shares.get(name, 0.0)) for name in spec.parameters}
    return found


def _with_one_value(one: SeenTrial, at: int) -> SeenTrial:
    return replace(one, trial=one.trial.model_copy(update={"values": (one.trial.values[at],)}))
