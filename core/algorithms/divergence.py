"""The error of a run whose values became non-finite."""

import numpy as np

from core.algorithms.algorithm import Algorithm, Failure, S
from core.errors import JobFailed
from core.reasons import Reason


def diverged(algorithm: Algorithm[S], failure: Failure, step: int) -> JobFailed:
    """The error for a failure, on the host, in the update after the last good state. step: of that state."""
    quantity = algorithm.quantities[int(np.argmax(failure.quantities))]
    within = int(failure.time_step) * algorithm.env_steps_per_time_step
    at = step + min(within, algorithm.settings.env_steps_per_update)
    return JobFailed(
        Reason.DIVERGED,
        f"The {quantity} became non-finite at environment step {at}; the last good state is that of "
        f"step {step}.",
        step=at,
        quantity=quantity,
    )
