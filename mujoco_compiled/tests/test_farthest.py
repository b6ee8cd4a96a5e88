"""Which vertex is farthest in a direction, beside a look at all of them."""

import numpy as np
import pytest

from mujoco_compiled.collisions.farthest import farthest_of
from mujoco_compiled.program.program import Program
from mujoco_compiled.tests.test_machine_code import run

NUM_DIRECTIONS = 2_000


def directions() -> np.ndarray:
    """[n, 3]: at random, and as many whose largest coordinates are alike: at edges of a cube's sides."""
    found = np.random.default_rng(0).normal(size=(NUM_DIRECTIONS, 3))
    found[::2] = np.round(4.0 * found[::2])
    return found[np.abs(found).max(axis=1) > 0.0].astype(np.float32)


@pytest.mark.parametrize("num_vertices", [8, 300])
def test_the_farthest_vertex_is_among_those_that_its_square_has(num_vertices: int) -> None:
    vertices, given = np.random.default_rng(1).normal(size=(num_vertices, 3)), directions()
    farthest, program = farthest_of("mesh", vertices), Program()
    number, vertex = farthest.at(list(program.inputs("direction", 3)))
    program.output("found", [number, *vertex])
    in_code, expected = run(program, {"direction": list(given.T)})["found"], (given @ vertices.T).max(axis=1)
    for numbers in (farthest.at(list(given.T))[0], in_code[0]):
        reach = np.einsum("ni,ni->n", vertices[numbers.astype(int)], given)
        np.testing.assert_allclose(reach, expected, rtol=1e-6)
    np.testing.assert_allclose(in_code[1:].T, vertices[in_code[0].astype(int)], rtol=1e-6)
    # In a square, far fewer than there are in all.
    counts = farthest.ends[1].values - farthest.ends[0].values
    assert counts.mean() < 4.0
