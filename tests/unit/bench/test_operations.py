"""What the engine `compiled` makes of a body, counted and shown."""

import pytest

from bench.operations import _STAGES, _excerpt, counts, model_of, substep_program
from core.physics.compiled import substep


def test_every_operation_of_the_ant_has_its_stage() -> None:
    program = substep_program(model_of("ant"))
    found = counts(program)
    assert found["solver", 2] < found["solver", 1] < found.total() / 2
    # The velocities' own: a product and a sum for each degree of freedom, and signs.
    assert found["the rest", 0] <= 4 * 14
    assert set(_STAGES) <= set(vars(substep))


def test_operations_are_shown_with_what_they_become() -> None:
    lines = list(_excerpt("inverted_pendulum", 5))
    machine, ptx = (
        next(i for i, line in enumerate(lines) if word in line) for word in ("machine code", "PTX")
    )
    assert 0 < machine < ptx < len(lines) - 1


def test_an_environment_without_a_model_of_its_own_is_refused() -> None:
    with pytest.raises(ValueError, match="own physics"):
        model_of("brax/ant")
