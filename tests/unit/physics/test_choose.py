"""From an engine's name to the engine: what keeps a worker from it, and the solver that it gets."""

import mujoco
import pytest

from core.errors import JobFailed
from core.physics import availability, compiled, native
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from core.physics.engine import SolverSettings
from core.physics.model import brax_model


@pytest.mark.parametrize("name", ["warp", "compiled"])
def test_a_worker_without_the_extra_ends_the_job_with_the_way_out(
    name: EngineName, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(availability, "find_spec", lambda name: None)
    with pytest.raises(JobFailed, match=f"uv sync --inexact --extra {name}") as failure:
        engine_builder(name)(brax_model("ant"), 1, ())
    assert failure.value.reason == "no_device"


def test_no_code_is_made_for_a_body_beyond_compiled_and_the_element_is_named() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="hip"/><geom size="0.1"/></body></worldbody>
        <actuator><motor name="drive" joint="hip" damping="0.1"/></actuator></mujoco>"""
    )
    with pytest.raises(JobFailed, match=r"'compiled' cannot run the model: its actuator 'drive'") as failure:
        engine_builder("compiled")(model, 1, ())
    assert failure.value.reason == "bad_model"


def test_no_code_is_made_for_fields_beyond_compiled() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="hip"/><geom size="0.1"/><site name="eye"/></body></worldbody>
        <actuator><motor joint="hip"/></actuator>
        <sensor><rangefinder name="ray" site="eye"/></sensor></mujoco>"""
    )
    with pytest.raises(JobFailed, match=r"'compiled' cannot run the model: .*sensor") as failure:
        engine_builder("compiled")(model, 1, ("sensordata",))
    assert failure.value.reason == "bad_model"


def test_compiled_solves_as_the_environment_asks_and_with_two_iterations_at_least(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[mujoco.MjModel] = []
    monkeypatch.setattr(compiled, "CompiledEngine", lambda model, *rest: made.append(model))
    ant = brax_model("ant")
    for settings in (
        SolverSettings(1, 4, implicit_damping=False),
        SolverSettings(7, 9, implicit_damping=True),
    ):
        engine_builder("compiled")(ant, 5, (), accelerated=settings)
    engine_builder("compiled")(ant, 5, ())
    solvers = [(model.opt.iterations, model.opt.ls_iterations) for model in made]
    assert solvers == [(2, 4), (7, 9), (ant.opt.iterations, ant.opt.ls_iterations)]
    explicit = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    assert [bool(model.opt.disableflags & explicit) for model in made] == [True, False, False]


def _solver(model: mujoco.MjModel) -> tuple[int, int, int]:
    return model.opt.solver, model.opt.iterations, model.opt.ls_iterations


def test_native_takes_what_the_job_says_of_the_solver_and_keeps_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[mujoco.MjModel] = []
    monkeypatch.setattr(native, "NativeEngine", lambda model, num_substeps, derived: made.append(model))
    ant = brax_model("ant")
    for settings in (
        SolverSettings(1, 3, implicit_damping=False),  # An environment's own, which no job has said.
        SolverSettings.of_job(None, None, implicit_damping=False),
        SolverSettings.of_job(6, None, implicit_damping=False, solver="cg"),
    ):
        engine_builder("native")(ant, 5, (), accelerated=settings)
    newton, own = int(mujoco.mjtSolver.mjSOL_NEWTON), (ant.opt.iterations, ant.opt.ls_iterations)
    assert [_solver(model) for model in made] == [
        (newton, *own),
        (newton, *own),
        (int(mujoco.mjtSolver.mjSOL_CG), 6, own[1]),
    ]
    assert {model.opt.disableflags for model in made} == {ant.opt.disableflags}


@pytest.mark.parametrize(("asked", "made_with"), [(None, (4, 8)), (1, (1, 8))])
def test_one_iteration_is_one_where_the_job_says_it(
    asked: int | None, made_with: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[mujoco.MjModel] = []
    monkeypatch.setattr(compiled, "CompiledEngine", lambda model, *rest: made.append(model))
    settings = SolverSettings.of_job(asked, None, implicit_damping=False)
    engine_builder("compiled")(brax_model("ant"), 5, (), accelerated=settings)
    assert _solver(made[0])[1:] == made_with
