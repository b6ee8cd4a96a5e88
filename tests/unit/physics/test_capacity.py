"""Room for contacts and constraint rows, from a short trial."""

import mujoco
import numpy as np
import pytest

from core.physics.capacity import Capacity, Demand, capacity, measure, num_near
from core.physics.model import brax_model

# Two balls of 0.1 m and a floor: all three pairs may touch.
BALLS = """
<mujoco>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body pos="0 0 0.5"><freejoint/><geom type="sphere" size="0.1"/></body>
    <body pos="0 0 1.5"><freejoint/><geom type="sphere" size="0.1"/></body>
  </worldbody>
</mujoco>
"""
PAIRS = np.array([[0, 1], [0, 2], [1, 2]])


def test_every_world_gets_twice_the_most_that_was_seen_of_one() -> None:
    # 10 contacts, 40 rows: room for 20 contacts in each of 5 worlds, together, and 80 rows in each alone.
    assert capacity(Demand(contacts=10, rows=40), 5) == Capacity(naconmax=100, njmax=80)


def test_a_body_that_touched_nothing_gets_some_room_all_the_same() -> None:
    assert capacity(Demand(contacts=0, rows=0), 4) == Capacity(naconmax=32, njmax=24)


@pytest.mark.parametrize(
    ("heights", "near"),
    [
        ((0.5, 1.5), 0),  # nothing within reach
        ((0.09, 1.5), 1),  # one ball on the floor
        ((0.5, 0.69), 1),  # two balls of 0.1 m, their centres 0.19 m apart
        ((0.09, 0.08), 3),  # all three
        ((-3.0, 1.5), 1),  # below a plane is inside it
    ],
)
def test_pairs_are_near_where_bounding_spheres_touch(heights: tuple[float, float], near: int) -> None:
    model = mujoco.MjModel.from_xml_string(BALLS)
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[9] = heights
    mujoco.mj_kinematics(model, data)
    assert num_near(model, data, PAIRS) == near
    assert num_near(model, data, PAIRS[:, ::-1]) == near
    assert num_near(model, data, PAIRS[:0]) == 0


def test_a_trial_counts_what_the_worlds_ask_for() -> None:
    # Both balls end on the floor, one beside or on the other: 2 or 3 contacts, each with 4 rows of a
    # pyramid (two tangents, both signs).
    demand = measure(mujoco.MjModel.from_xml_string(BALLS), PAIRS)
    assert demand.contacts in (2, 3)
    assert demand.rows in (8, 12)


def test_a_trial_is_the_same_each_time() -> None:
    ant = brax_model("ant")
    pairs = np.array([[0, geom] for geom in range(1, ant.ngeom)])
    demand = measure(ant, pairs)
    assert demand == measure(ant, pairs)
    # Four feet on the floor, four rows each; its legs' joints reach their limits, too.
    assert demand.contacts >= 4
    assert demand.rows > 16


def test_a_model_without_actuators_or_pairs_asks_for_nothing() -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    assert measure(model, PAIRS[:0]) == Demand(contacts=0, rows=0)
