"""The robots that users bring, as their authors publish them: each moves as in C MuJoCo.

Machine code in single precision is set down in 50 of C MuJoCo's states, half of them after a fall, under
random controls, and compared after 50 substeps with the same solver settings. C MuJoCo itself, begun in the
same states in single precision, is the measure: a Go2's legs meet with a capsule along the edges of boxes,
where rounding decides at how many points they touch. Differences in half of the tries and in nine of ten, in
parts of the motion, and those of C MuJoCo itself, measured 2026-11-28:

go1 (feet)     1.5e-6 4.1e-6   9.3e-8 1.8e-7
g1 (feet)      9.4e-7 3.2e-6   9.2e-8 1.6e-7
a2             4.7e-7 1.4e-6   7.4e-8 1.7e-7
aliengo        1.2e-6 2.3e-3   5.0e-7 5.9e-3
b2             7.8e-3 5.7e-2   5.0e-4 1.1e-2   (ends of cylinders on boxes)
go1            7.1e-6 7.5e-4   8.9e-8 1.8e-7   (cylinders)
go2            3.2e-3 3.3e-2   2.6e-3 2.5e-2
hyqreal1       3.1e-6 6.3e-4                   (meshes pass through each other in both)
hyqreal2       2.2e-6 8.3e-6   1.6e-7 4.8e-7
mini_cheetah   4.2e-6 1.0e-2                   (meshes)
pegasus        5.6e-7 1.1e-6   1.6e-7 2.7e-7
spot           1.5e-5 5.5e-4                   (meshes)
g1             2.3e-6 1.8e-5   1.8e-7 7.2e-7
humanoid       5.1e-6 1.8e-5   3.3e-7 3.2e-6
"""

from dataclasses import replace

import mujoco
import pytest

from bench.bodies import PUBLISHED, find
from core.errors import JobFailed
from core.physics.compiled import CompiledEngine
from core.physics.native import NativeEngine
from core.physics.trial import ReferenceMotion, compare, passing, record
from mujoco_compiled import meshes_left_out
from tests.extra import extra

# In a control step, of which `compare` makes two.
NUM_SUBSTEPS = 25
# In half of the tries and in nine of ten: what an upload's trial allows, for robots whose meshes pass through
# each other, and somewhat more than measured where points are not MuJoCo's: of polygons of a B2's hips, whose
# ends lie on boxes, MuJoCo takes other corners.
ALLOWED = (1e-3, 0.1)
MEASURED = {"b2_whole": (0.02, 0.1)}


def model_of(name: str) -> mujoco.MjModel:
    try:
        return find(name).model
    except JobFailed as error:
        pytest.skip(str(error))


def moved_on(model: mujoco.MjModel, begun: ReferenceMotion) -> ReferenceMotion:
    """The same tries, of 50 substeps each."""
    ended = {name: begun.ended[name].copy() for name in ("qpos", "qvel", "act")}
    for number, controls in enumerate(begun.ctrl):
        data = mujoco.MjData(model)
        for name in (*ended, "qacc_warmstart"):
            getattr(data, name)[:] = begun.begun[name][number]
        for one in controls:
            data.ctrl[:] = one
            mujoco.mj_step(model, data, NUM_SUBSTEPS)
        assert not any(warning.number for warning in data.warning)
        for name, values in ended.items():
            values[number] = getattr(data, name)
    return replace(begun, num_substeps=NUM_SUBSTEPS, ended=ended)


@pytest.mark.parametrize("name", ["go1", *extra("g1", *PUBLISHED)])
def test_a_robot_moves_as_in_mujoco(name: str) -> None:
    model = model_of(name)
    apart = meshes_left_out(model)
    begun = record(model, apart=apart)
    assert begun is not None
    with passing(apart):
        reference = moved_on(model, begun)
    found = compare(CompiledEngine(model, NUM_SUBSTEPS, ()), reference)
    assert not found.broken
    if apart or name in MEASURED:
        half, most = MEASURED.get(name, ALLOWED)
        assert (found.half < half, found.most < most) == (True, True), found
        return
    itself = compare(NativeEngine(model, NUM_SUBSTEPS, ()), reference)
    assert found.half < 1e-5 + 2.0 * itself.half, (found, itself)
    # The worst of a Go2's tries depend on the last bits of the solver, too.
    assert found.most < 1e-3 + 2.5 * itself.most, (found, itself)
