"""Whether a replay, an update, a run and its starts go together, for any off-policy algorithm."""

from core.algorithms.memory import shown
from core.algorithms.off_policy.memory import replay_bytes
from core.algorithms.off_policy.spec import OffPolicySpec
from core.algorithms.starts import unreachable_curriculum
from core.environments.info import EnvironmentInfo
from core.errors import Problem, Rejected

# A checkpoint holds the replay, and MessagePack holds 4 GiB; networks and environments take the rest.
_MOST_BYTES = 3 * 2**30


def replay_refusal(
    settings: OffPolicySpec, environment: EnvironmentInfo, numbers_per_action: int
) -> Rejected | None:
    """Why these values do not go together; None where they do. numbers_per_action: see `replay_bytes`."""
    return (
        _too_few_rows(settings)
        or _never_learns(settings)
        or _too_large_for_a_checkpoint(settings, environment, numbers_per_action)
        or unreachable_curriculum(settings.reset_pool_size, environment)
    )


def rejected(detail: str, *names: str) -> Rejected:
    """The refusal of these hyperparameters together."""
    return Rejected(detail, [Problem(f"/algorithm/{name}", detail) for name in names])


def _too_few_rows(settings: OffPolicySpec) -> Rejected | None:
    """A sample is n steps and the row after them; an update's rows are written at once."""
    needed = max(settings.unroll_length, settings.n_step + 1)
    if settings.replay_rows >= needed:
        return None
    return rejected(
        f"max_replay_size = {settings.max_replay_size} keeps {settings.replay_rows} actions of each of "
        f"{settings.num_envs} environments; with unroll_length = {settings.unroll_length} and n_step = "
        f"{settings.n_step} it has to keep {needed}: {needed * settings.num_envs} or more.",
        "max_replay_size",
        "num_envs",
        "unroll_length",
        "n_step",
    )


def _never_learns(settings: OffPolicySpec) -> Rejected | None:
    """Learning begins when so many transitions have been made, kept or not; a run has to make them."""
    made = settings.num_actions
    if settings.min_replay_size <= made:
        return None
    return rejected(
        f"The run ends after {made} transitions, before there are min_replay_size = "
        f"{settings.min_replay_size} of them to learn from.",
        "min_replay_size",
        "num_timesteps",
    )


def _too_large_for_a_checkpoint(
    settings: OffPolicySpec, environment: EnvironmentInfo, numbers_per_action: int
) -> Rejected | None:
    size = replay_bytes(settings, environment, numbers_per_action)
    if size <= _MOST_BYTES:
        return None
    return rejected(
        f"max_replay_size = {settings.max_replay_size} transitions of {environment.id} take {shown(size)}; "
        f"a checkpoint holds them and has room for {shown(_MOST_BYTES)}.",
        "max_replay_size",
    )
