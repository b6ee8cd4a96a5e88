"""Which of PPO's hyperparameters go together: what Brax's assertions refuse, and what Brax does not check."""

from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.starts import unreachable_curriculum
from core.environments.info import Device, EnvironmentInfo
from core.errors import Problem, Rejected


def refusal(settings: PPOSpec, environment: EnvironmentInfo, device: Device) -> Rejected | None:
    """Why these values do not go together, or not with this environment; None where they do."""
    return (
        _uneven_batch(settings, device)
        or _crossed_learning_rates(settings)
        or _unknown_observation(settings, environment)
        or unreachable_curriculum(settings.reset_pool_size, environment)
    )


def _uneven_batch(settings: PPOSpec, device: Device) -> Rejected | None:
    unrolls = settings.batch_size * settings.num_minibatches
    if unrolls % settings.num_envs == 0:
        return None
    return Rejected(
        f"On a {device.upper()}, batch_size × num_minibatches = {settings.batch_size} × "
        f"{settings.num_minibatches} = {unrolls} is not a multiple of num_envs = {settings.num_envs}; "
        f"every environment must contribute the same number of unrolls to a batch.",
        [
            Problem(f"/algorithm/{name}", f"{getattr(settings, name)} does not go together with the others.")
            for name in ("batch_size", "num_minibatches", "num_envs")
        ],
    )


def _crossed_learning_rates(settings: PPOSpec) -> Rejected | None:
    lowest, highest = settings.learning_rate_schedule_min_lr, settings.learning_rate_schedule_max_lr
    if lowest <= highest:
        return None
    detail = (
        f"learning_rate_schedule_min_lr = {lowest:g} is above learning_rate_schedule_max_lr = {highest:g}."
    )
    names = ("learning_rate_schedule_min_lr", "learning_rate_schedule_max_lr")
    return Rejected(detail, [Problem(f"/algorithm/{name}", detail) for name in names])


def _unknown_observation(settings: PPOSpec, environment: EnvironmentInfo) -> Rejected | None:
    """The catalog's environments have one observation each, under Brax's name for it."""
    problems = [
        Problem(
            f"/algorithm/{name}",
            f"{environment.id} has one observation, 'state', and none called {key!r}.",
        )
        for name in ("policy_obs_key", "value_obs_key")
        if (key := getattr(settings, name)) != "state"
    ]
    return Rejected(problems[0].detail, problems) if problems else None
