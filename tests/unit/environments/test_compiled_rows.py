"""What the catalog says that `compiled` cannot run, against the models themselves."""

from typing import Any

import mujoco
import pytest

from core.environments import catalog
from core.environments.randomization import FIELDS
from core.errors import JobFailed
from core.physics.compiled import check_solver
from core.physics.coverage import check_runs
from core.physics.engine import CONSTANTS, Engine, SolverSettings
from core.physics.model import with_solver_of_compiled
from mujoco_compiled import uncovered_own
from tests.extra import extra

# Options that change the model, and not only the reward.
CHANGED: list[tuple[str, dict[str, Any]]] = [
    *(
        ("corridor", {"walker": walker, "arena": arena})
        for walker in ("ant", "rodent", "humanoid")
        for arena in ("empty", "gaps", "walls")
    ),
    ("corridor", {"walker": "humanoid_2019_torque", "arena": "empty"}),
    *(("corridor", {"walker": "rolling_ball", "arena": arena}) for arena in ("empty", "gaps", "walls")),
    ("corridor", {"contact_termination": True, "observables": ["cinert", "cvel", "qfrc_actuator"]}),
    ("corridor", {"walker": "humanoid", "arena": "walls", "contact_termination": True}),
    ("corridor", {"walker": "rodent", "solver": "cg"}),
    ("rodent", {"solver": "cg"}),
    ("brittle_star", {"walls": "contacts"}),
    # 1,050 constraint rows, 988, 1,006 and 992.
    ("brittle_star", {"walls": "contacts", "num_segments_per_arm": 3}),
    ("brittle_star", {"walls": "contacts", "num_segments_per_arm": [7, 0, 7], "num_arms": 3}),
    ("brittle_star", {"num_segments_per_arm": 14}),
    ("brittle_star", {"num_segments_per_arm": 23, "num_arms": 3}),
    ("brittle_star", {"observables": ["joint_position", "actuator_force"]}),
    ("brittle_star", {"actuation": "torque_control", "target_position": [1, 1]}),
    ("brittle_star", {"num_segments_per_arm": [0, 0, 1], "num_arms": 3}),
    ("brittle_star_undirected", {"control": "cpg"}),
]


class Asked(Exception):
    """The model that an environment asks an engine for, and the fields that it reads."""

    def __init__(
        self, model: mujoco.MjModel, derived: tuple[str, ...], settings: SolverSettings | None
    ) -> None:
        self.model, self.derived, self.settings = model, derived, settings


class Asking:
    """Ends the making of the environment where it has its model: nothing is compiled."""

    name = "compiled"

    def __call__(
        self,
        model: mujoco.MjModel,
        num_substeps: int,
        derived: tuple[str, ...],
        *,
        accelerated: SolverSettings | None = None,
    ) -> Engine:
        raise Asked(with_solver_of_compiled(model, accelerated), derived, accelerated)


def asked_for(environment: str, options: dict[str, Any]) -> Asked:
    info, parsed = catalog.resolve(environment, options)
    with pytest.raises(Asked) as asked:
        catalog.make(info, parsed, Asking())
    return asked.value


def refusal(asked: Asked) -> str | None:
    try:
        check_solver(asked.settings)
        check_runs("compiled", asked.model, asked.derived)
    except JobFailed as failure:
        return failure.detail
    return None


@pytest.mark.parametrize(
    ("environment", "options"),
    [*((name, {}) for name, info in catalog.BUILT_IN.items() if not info.takes_model), *extra(*CHANGED)],
)
def test_a_row_refuses_what_its_model_has_and_the_engine_lacks_and_nothing_else(
    environment: str, options: dict[str, Any]
) -> None:
    # Where the engine has learned what it lacked: correct the row's `cannot_run`, or delete it there.
    info, _ = catalog.resolve(environment, options)
    assert info.cannot_run.get("compiled") == refusal(asked_for(environment, options))


@pytest.mark.parametrize(
    "environment",
    [
        name
        for name, info in catalog.BUILT_IN.items()
        # For users' models, `auto` does look.
        if not info.takes_model
        and any(rule.engine == "compiled" for rule in (*info.on_a_cpu, *info.on_a_gpu))
    ],
)
def test_what_auto_moves_by_it_may_be_randomized_in_every_field(environment: str) -> None:
    # `auto` does not look at a job's randomization: it must fail no job that `native` would run.
    assert uncovered_own(asked_for(environment, {}).model, (*FIELDS, *CONSTANTS)) is None


def test_environments_with_physics_of_their_own_refuse_it() -> None:
    others = [info for info in catalog.ENVIRONMENTS.values() if info.family != "gaitway"]
    assert {info.family for info in others} == {"brax", "playground"}
    assert all("compiled" in info.cannot_run for info in others)
