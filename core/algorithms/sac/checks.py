"""Which of SAC's hyperparameters go together."""

from core.algorithms.memory import shown
from core.algorithms.sac.memory import replay_bytes
from core.algorithms.sac.spec import SACSpec
from core.algorithms.starts import unreachable_curriculum
from core.environments.info import Device, EnvironmentInfo
from core.errors import Problem, Rejected

# A checkpoint holds the replay, and MessagePack holds 4 GiB; networks and environments take the rest.
_MOST_BYTES = 3 * 2**30


def refusal(settings: SACSpec, environment: EnvironmentInfo, device: Device) -> Rejected | None:
    """Why these values do not go together; None where they do."""
    return (
        _empty_range(settings)
        or _too_few_rows(settings)
        or _never_learns(settings)
        or _too_large_for_a_checkpoint(settings, environment)
        or unreachable_curriculum(settings.reset_pool_size, environment)
    )


def _empty_range(settings: SACSpec) -> Rejected | None:
    if settings.value_min < settings.value_max:
        return None
    return _rejected(
        f"value_min = {settings.value_min:g} is not below value_max = {settings.value_max:g}: "
        "the critics need a range of returns.",
        "value_min",
        "value_max",
    )


def _too_few_rows(settings: SACSpec) -> Rejected | None:
    """A sample is n steps and the row after them; an update's rows are written at once."""
    needed = max(settings.unroll_length, settings.n_step + 1)
    if settings.replay_rows >= needed:
        return None
    return _rejected(
        f"max_replay_size = {settings.max_replay_size} keeps {settings.replay_rows} actions of each of "
        f"{settings.num_envs} environments; with unroll_length = {settings.unroll_length} and n_step = "
        f"{settings.n_step} it has to keep {needed}: {needed * settings.num_envs} or more.",
        "max_replay_size",
        "num_envs",
        "unroll_length",
        "n_step",
    )


def _never_learns(settings: SACSpec) -> Rejected | None:
    """Learning begins when so many transitions have been made, kept or not; a run has to make them."""
    made = settings.num_updates * settings.unroll_length * settings.num_envs
    if settings.min_replay_size <= made:
        return None
    return _rejected(
        f"The run ends after {made} transitions, before there are min_replay_size = "
        f"{settings.min_replay_size} of them to learn from.",
        "min_replay_size",
        "num_timesteps",
    )


def _too_large_for_a_checkpoint(settings: SACSpec, environment: EnvironmentInfo) -> Rejected | None:
    size = replay_bytes(settings, environment)
    if size <= _MOST_BYTES:
        return None
    return _rejected(
        f"max_replay_size = {settings.max_replay_size} transitions of {environment.id} take {shown(size)}; "
        f"a checkpoint holds them and has room for {shown(_MOST_BYTES)}.",
        "max_replay_size",
    )


def _rejected(detail: str, *names: str) -> Rejected:
    return Rejected(detail, [Problem(f"/algorithm/{name}", detail) for name in names])
