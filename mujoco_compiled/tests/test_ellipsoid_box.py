"""An ellipsoid against a box, beside C MuJoCo with its iterations converged."""

import mujoco
import numpy as np
import pytest

from mujoco_compiled.collisions.ellipsoid_box import ellipsoid_box
from mujoco_compiled.collisions.shapes import Placed
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.program import Program

NUM_STATES = 2000
SIZE, RADII = [0.5, 0.4, 0.3], [0.03, 0.05, 0.08]
UNTURNED = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
XML = f"""
<mujoco><option ccd_tolerance="1e-12" ccd_iterations="200"/><worldbody>
  <geom type="box" size="{SIZE[0]} {SIZE[1]} {SIZE[2]}" euler="10 20 30"/>
  <body><freejoint/><geom type="ellipsoid" size="{RADII[0]} {RADII[1]} {RADII[2]}"/></body>
</worldbody></mujoco>
"""


@pytest.mark.extra
def test_an_ellipsoid_touches_a_box_as_in_mujoco() -> None:
    """At faces, edges and corners: to 1e-8 m, and MuJoCo's own error of the normal."""
    model, generator = mujoco.MjModel.from_xml_string(XML), np.random.default_rng(0)
    datas = [mujoco.MjData(model) for _ in range(NUM_STATES)]
    for data in datas:
        local, face = SIZE * generator.uniform(-1.05, 1.05, size=3), generator.integers(3)
        local[face] = np.copysign(SIZE[face] + generator.uniform(0.0, 0.08), local[face])
        mujoco.mj_kinematics(model, data)
        data.qpos[:3] = data.geom_xmat[0].reshape(3, 3) @ local
        data.qpos[3:] = generator.normal(size=4)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_forward(model, data)
    (touch,) = ellipsoid_box(placed(datas, 1, RADII), placed(datas, 0, SIZE))
    normal, position = np.stack(touch.normal, 1), np.stack(touch.position, 1)
    at_edges = 0
    for number, data in enumerate(datas):
        if not data.ncon:
            assert touch.distance[number] > -1e-9
            continue
        contact = data.contact[0]
        if contact.dist < -0.25 * min(RADII):
            continue
        sign = 1.0 if contact.geom[0] == 1 else -1.0
        assert abs(touch.distance[number] - contact.dist) < 1e-8
        np.testing.assert_allclose(normal[number], sign * contact.frame[:3], atol=2e-4)
        np.testing.assert_allclose(position[number], contact.pos, atol=2e-5)
        at_edges += np.abs(data.geom_xmat[0].reshape(3, 3).T @ normal[number]).max() < 0.999
    assert at_edges > 20


def test_its_radii_may_be_symbols_of_a_program() -> None:
    """As where geoms share a program: each calls it with its own."""
    box = Placed([0.0, 0.0, 0.0], UNTURNED, UNTURNED, SIZE)
    program, above = Program(), [0.1, 0.05, 0.36]
    written = Placed(above, UNTURNED, UNTURNED, program.inputs("radii", 3))
    program.output("distance", [touch.distance for touch in ellipsoid_box(written, box)])
    (found,) = interpret(program, {"radii": [np.array([radius]) for radius in RADII]})["distance"]
    # Flat on the upper face: 0.36 - 0.3 - 0.08.
    np.testing.assert_allclose(found, -0.02, atol=1e-12)


def placed(datas: list[mujoco.MjData], geom: int, size: list[float]) -> Placed:
    rotations = np.stack([data.geom_xmat[geom].reshape(3, 3) for data in datas], axis=-1)
    position = list(np.stack([data.geom_xpos[geom] for data in datas], axis=-1))
    return Placed(position, [list(row) for row in rotations], UNTURNED, size)
