"""Another job's decoder as the action of a body whose options are not a task of terms themselves.

What the decoder sees is added to the observation that the options make, behind it.
"""

from typing import Annotated

from pydantic import AfterValidator, ValidationError

from core.environments.terms.actions import DecoderAction
from core.environments.terms.task import TaskOptions, observed
from core.environments.terms.vocabulary import AnyObservation


def seen_by(action: DecoderAction | None) -> list[AnyObservation]:
    """The terms that the decoder sees; none before a submission has filled them in.

    Raises ValidationError.
    """
    if action is None or not action.sees:
        return []
    return TaskOptions.model_validate({"observation": action.sees}).observation or []


def behind(task: TaskOptions, action: DecoderAction | None) -> TaskOptions:
    """The task, whose action is the decoder's, and which sees what the decoder sees."""
    if action is None:
        return task
    has = observed(task)
    seen = [*has, *(term for term in seen_by(action) if term not in has)]
    return task.model_copy(update={"action": action, "observation": seen})


def _has_terms_of_a_body(action: DecoderAction | None) -> DecoderAction | None:
    try:
        seen = seen_by(action)
    except ValidationError:
        seen = None
    if seen is None or any(term.needed - {"free_root"} for term in seen):
        raise ValueError("`sees` has not what a decoder of this body sees: leave it out, it is filled in")
    return action


LentDecoder = Annotated[DecoderAction | None, AfterValidator(_has_terms_of_a_body)]
LENT_DECODER = "The decoder of another job's policy (docs/training.md); null: the controls."
