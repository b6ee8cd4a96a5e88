"""A body of the catalog as a page: its model, its options, the task of terms that they make, and its row."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any, Literal, Protocol

from core.documents import Strict
from core.environments.info import EnvironmentInfo
from core.environments.terms import reference_check
from core.environments.terms.inventory import Inventory, inventory_of, names_by_kind, parts_by_kind
from core.environments.terms.rewards import Alive, Healthy
from core.environments.terms.task import Reset, TaskOptions, control_step_s, curriculum, task_slices
from core.environments.terms.terminations import AnyTermination
from core.errors import Problem


def page(  # noqa: PLR0913 # A row's fields.
    id: str,
    model: str,
    task: Callable[[Any], TaskOptions],
    options: type[Strict],
    *,
    unit_of_action: str | None = "1",
    reports: Mapping[str, Any] | None = None,
    vary: Callable[[Any], Mapping[str, Any]] | None = None,
    **facts: Any,
) -> EnvironmentInfo:
    """The row of a body whose options make the task.

    model: `module:function`, called as `function(id, options)`, which returns the specification and the
    settings of the solver: see `core.environments.page_env`. reports: fields of `TaskSettings`. vary: as in
    the row, besides the length of a step. facts: further fields of the row.
    """
    parts, default = _parts(id, model, options), task(options())

    def check(chosen: Any) -> Sequence[Problem]:
        return list(reference_check.problems(task(chosen), parts))

    def dt(chosen: TaskOptions) -> float:
        return round(control_step_s(chosen, parts), 9)

    return EnvironmentInfo(
        id=id,
        factory="core.environments.page_env:make",
        observation_size=task_slices(default, parts).observation_size,
        action_size=parts.sizes.nu,
        dt=dt(default),
        episode_length=1000,
        tracked_body=parts.root,
        cameras=tuple(filter(None, parts.cameras)),
        options=options,
        slices=lambda chosen: task_slices(task(chosen), parts, unit_of_action),
        parts=parts_by_kind(parts),
        names=names_by_kind(parts),
        arguments={"body": id, "model": model, "task": task, **(reports or {})},
        vary=lambda chosen: {
            "dt": dt(task(chosen)),
            **curriculum(task(chosen)),
            **(vary(chosen) if vary else {}),
        },
        check=facts.pop("check", check),
        **facts,
    )


def task_of(row: EnvironmentInfo, options: Strict) -> TaskOptions | None:
    """The task of terms that these options of the row are, or make; None: no terms say what the body does."""
    if isinstance(options, TaskOptions):
        return options
    makes: Callable[[Strict], TaskOptions] | None = row.arguments.get("task")
    return None if makes is None else makes(options)


def with_task(row: EnvironmentInfo, options: Strict, task: TaskOptions) -> tuple[EnvironmentInfo, Strict]:
    """The row and the options whose body does this task, which `task_of` has for them, in place of theirs."""
    if isinstance(options, TaskOptions):
        return row, task
    return replace(row, arguments={**row.arguments, "task": lambda _: task}), options


def _parts(body: str, model: str, options: type[Strict]) -> Inventory:
    """The parts of the body's model. Those of a body that the table lacks are read from its model, which
    loads MuJoCo: see `core.environments.describe_bodies`."""
    try:
        return inventory_of(body)
    except KeyError:
        return import_module("core.environments.page_env").parts_of(body, model, options())


class HealthyOptions(Protocol):
    """The options of a body that may fall."""

    healthy_reward: float
    terminate_when_unhealthy: bool


def survival(
    options: HealthyOptions, name: str, ends: list[AnyTermination]
) -> tuple[Alive | Healthy, list[AnyTermination]]:
    """The reward for being healthy, and what ends an episode. ends: what is unhealthy.

    If that ends the episode, the step that ends it still earns the reward (as in Brax); otherwise an
    unhealthy step earns none.
    """
    if options.terminate_when_unhealthy:
        return Alive(weight=options.healthy_reward, name=name), ends
    return Healthy(weight=options.healthy_reward, name=name, unless=ends), []


def noisy(scale: float, velocities: Literal["uniform", "normal"] = "uniform", lift: float = 0.0) -> Reset:
    """A start with this noise on positions and velocities. lift: m."""
    return Reset(position_noise=scale, velocity_noise=scale, velocity_distribution=velocities, lift=lift)
