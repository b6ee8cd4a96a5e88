"""Touch, contact, acceleration and force sensors against C MuJoCo's: forces are those of the last substep."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mujoco_compiled.coverage import uncovered, uncovered_fields
from mujoco_compiled.fields import Fields
from mujoco_compiled.readings.scene import Scene
from mujoco_compiled.readings.sensors import sensor_values
from mujoco_compiled.substep import (
    Model,
    Moved,
    SubstepState,
    read_model,
    readings_by_sensor,
    unmoved,
    with_sensors,
)
from mujoco_compiled.tests.states import converge, of_all
from mujoco_compiled.tests.test_contacts import PLANE, at_random, meeting

# Sites about a ball, a rod and a box, each larger than its geom by half the contacts' margin.
FELT_BALL = '<geom name="left" type="sphere" size="0.2" pos="0.05 0 0"/><site name="left" size="0.36"/>'
FELT_ROD = """<geom name="rod" type="capsule" size="0.1 0.2" euler="20 50 0"/>
  <site name="rod" type="capsule" size="0.21 0.2" euler="20 50 0"/>"""
FELT_BOX = (
    '<geom name="rod" type="box" size="0.1 0.2 0.1"/><site name="rod" type="box" size="0.3 0.31 0.32"/>'
)
SENSORS = """<sensor>
  <touch name="felt" site="left"/><touch site="rod" cutoff="20"/>
  <contact geom1="left" data="found"/><contact geom1="rod" geom2="left" data="found" cutoff="0.5"/>
  <contact geom1="still" geom2="rod" data="found"/><jointpos joint="b"/>
  <accelerometer site="left"/><framelinacc objtype="geom" objname="rod"/>
  <frameangacc objtype="body" objname="right"/>
</sensor>"""


def sensing(model: mujoco.MjModel) -> Model:
    read = read_model(model)
    solver = replace(read.solver, iterations=20, line_search_iterations=30)
    return with_sensors(replace(read, solver=solver), model)


def values_of(ours: Model, model: mujoco.MjModel, moved: Moved) -> list[np.ndarray]:
    readings = readings_by_sensor(ours, moved)
    return sensor_values(Scene(Fields(model), moved.qpos, moved.qvel, 0.0, readings))


@pytest.mark.parametrize(
    ("right", "option", "default"),
    [
        (FELT_ROD, "", ""),
        (FELT_ROD, 'cone="elliptic"', 'margin="0.1" gap="0.05"'),
        (FELT_BOX, "", 'condim="1"'),
    ],
)
def test_contacts_are_felt_as_in_mujoco(right: str, option: str, default: str) -> None:
    pair = "" if "box" not in right else '<contact><exclude body1="left" body2="right"/></contact>'
    model = converge(meeting(PLANE, FELT_BALL, right, option, default, pair + SENSORS), implicit_damping=True)
    assert uncovered_fields(model, ("sensordata",)) is None
    ours, datas = sensing(model), at_random(model)
    moved = unmoved(
        ours, SubstepState(of_all(datas, "qpos"), of_all(datas, "qvel"), [], of_all(datas, "qvel")), []
    )
    theirs = of_all(datas, "sensordata")
    assert sum(np.abs(values).any() for values in theirs) > 4
    for mine, expected in zip(values_of(ours, model, moved), theirs, strict=True):
        np.testing.assert_allclose(np.broadcast_to(mine, len(datas)), expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("mine", "other", "reason"),
    [
        ("0.36", "0.2", "sensor 'felt' is not about all of the body's geom 'left'"),
        ('geom1="left" data="found"', 'geom1="left" data="found force"', "other data of contacts"),
        ('geom1="left" data="found"', 'body1="left" data="found"', "other things than geoms"),
    ],
)
def test_what_is_felt_otherwise_is_named(mine: str, other: str, reason: str) -> None:
    parts = [text.replace(mine, other) for text in (FELT_BALL, FELT_ROD)]
    model = meeting(PLANE, *parts, more=SENSORS.replace(mine, other))
    assert uncovered(model) is None
    assert reason in (uncovered_fields(model, ("sensordata",)) or "")
