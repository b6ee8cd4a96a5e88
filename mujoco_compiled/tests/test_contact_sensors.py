"""Touch, contact, acceleration and force sensors against C MuJoCo's: forces are those of the last substep."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mujoco_compiled.coverage import uncovered, uncovered_fields
from mujoco_compiled.fields import Fields
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.program import Program
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
from mujoco_compiled.tests.test_contacts import NUM_STATES, PLANE, at_random, meeting

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
# Four balls that touch the floor and each other: ten pairs, which are in a table.
BALLS = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    {bodies}
  </worldbody>
  <sensor>{sensors}</sensor>
</mujoco>
"""


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


def balls() -> mujoco.MjModel:
    bodies, sensors = "", ""
    for number in range(4):
        name = f'name="{number}"'
        bodies += (
            f'<body {name} pos="{0.15 * number} 0 0.1"><freejoint/>'
            f'<geom {name} size="0.1"/><site {name} size="0.11"/></body>'
        )
        sensors += f'<touch site="{number}"/><contact geom1="floor" geom2="{number}" data="found"/>'
        sensors += f'<contact geom1="{number}" data="found"/>'
    return mujoco.MjModel.from_xml_string(BALLS.format(bodies=bodies, sensors=sensors))


def test_contacts_in_a_table_are_felt_as_in_mujoco() -> None:
    model, generator, datas = converge(balls(), implicit_damping=True), np.random.default_rng(0), []
    for _ in range(NUM_STATES):
        data = mujoco.MjData(model)
        data.qpos[[0, 7, 14, 21]] *= generator.uniform(0.8, 1.4)
        data.qpos[[2, 9, 16, 23]] += generator.uniform(-0.02, 0.02, size=4)
        data.qvel[:] = generator.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        datas.append(data)
    ours, program = sensing(model), Program()
    assert ours.constraints.are_in_slots
    given = {name: of_all(datas, name) for name in ("qpos", "qvel")}
    symbols = {name: list(program.inputs(name, len(values))) for name, values in given.items()}
    moved = unmoved(ours, SubstepState(symbols["qpos"], symbols["qvel"], [], symbols["qvel"]), [])
    program.output("sensordata", values_of(ours, model, moved))
    theirs = of_all(datas, "sensordata")
    assert all(np.any(values > 0.0) and np.any(values == 0.0) for values in theirs)
    for mine, expected in zip(interpret(program, given)["sensordata"], theirs, strict=True):
        np.testing.assert_allclose(mine, expected, rtol=1e-8, atol=1e-8)


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
