"""A page of the catalog as an environment."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import mujoco

from core.documents import Strict
from core.environments.task import TaskEnv, TaskSettings
from core.environments.task_model import compiled, stepped_model
from core.environments.terms.describe import inventory
from core.environments.terms.inventory import Inventory
from core.environments.terms.task import TaskOptions
from core.physics.engine import EngineBuilder, SolverSettings


def make(
    options: Strict,
    build_engine: EngineBuilder,
    *,
    body: str,
    model: str,
    task: Callable[[Any], TaskOptions],
    **settings: Any,
) -> TaskEnv:
    """The page's task under these options. model: see `terms.page.page`. settings: fields of TaskSettings."""
    spec, solver = _loaded(body, model, options)
    parts, terms = inventory(compiled(spec)), task(options)
    stepped = stepped_model(spec, terms, parts)
    return TaskEnv(terms, parts, spec, stepped, build_engine, TaskSettings(solver, **settings))


def parts_of(body: str, model: str, options: Strict) -> Inventory:
    """The parts of the page's model."""
    return inventory(compiled(_loaded(body, model, options)[0]))


def _loaded(body: str, model: str, options: Strict) -> tuple[mujoco.MjSpec, SolverSettings | None]:
    module, _, function = model.partition(":")
    return getattr(import_module(module), function)(body, options)
