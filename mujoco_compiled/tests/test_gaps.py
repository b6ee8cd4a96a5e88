"""What stands for two geoms' distance until they are nearly there: never more than C MuJoCo's distance."""

import mujoco
import numpy as np
import pytest

from mujoco_compiled.collisions.shapes import Placed
from mujoco_compiled.collisions.table import GAPS
from mujoco_compiled.tests.test_ellipsoid_box import UNTURNED

NUM_STATES = 500
# Of MuJoCo's search, in m.
ACCURACY = 1e-5


@pytest.mark.parametrize("kinds", GAPS)
def test_a_gap_is_no_more_than_the_distance(kinds: tuple[int, int]) -> None:
    spec, generator = mujoco.MjSpec(), np.random.default_rng(2)
    for kind in kinds:
        body = spec.worldbody.add_body()
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom(kind), size=[0.1, 0.2, 0.3], mass=1.0)
    model = spec.compile()
    data = mujoco.MjData(model)
    distances, placed = list[float](), list[np.ndarray]()
    for _ in range(NUM_STATES):
        data.qpos[:] = generator.normal(scale=0.3, size=model.nq)
        mujoco.mj_kinematics(model, data)
        distances.append(mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None))
        placed.append(np.hstack([data.geom_xpos, data.geom_xmat]))
    one, other = (
        Placed(list(numbers[:3]), [list(row) for row in numbers[3:].reshape(3, 3, -1)], UNTURNED, size)
        for numbers, size in zip(np.array(placed).transpose(1, 2, 0), model.geom_size.tolist(), strict=True)
    )
    gaps = np.asarray(GAPS[kinds](one, other))
    assert (gaps < np.array(distances) + ACCURACY).all()
    # It is of use: of the geoms that are apart by more than a tenth, it tells most.
    are_apart = np.array(distances) > 0.1
    assert np.count_nonzero(are_apart) > 0.3 * NUM_STATES
    assert (gaps[are_apart] > 0.0).mean() > 0.9
