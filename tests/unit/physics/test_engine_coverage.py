"""What an engine would leave out in silence is found before it is built, and named."""

import mujoco
import numpy as np
import pytest

from core.errors import JobFailed, Rejected
from core.physics.availability import EngineName, check_physics
from core.physics.choose import engine_builder
from core.physics.coverage import check_runs, unread_by_engine, unrun

ARM = """
<mujoco>
  <extension>{extension}</extension>
  <option timestep="0.004" {option}/>
  <asset><hfield name="hills" nrow="2" ncol="2" elevation="0 1 1 0" size="2 2 0.1 0.1"/></asset>
  <worldbody>
    <geom name="floor" {floor}/>
    <body name="arm" pos="0 0 1">
      <joint name="elbow" axis="0 1 0" damping="0.1"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" {rod}/>
    </body>
  </worldbody>
  <actuator>{motor}</actuator>
  <sensor>{sensor}</sensor>
</mujoco>
"""
PID = (
    '<plugin plugin="mujoco.pid"><instance name="pid"><config key="kp" value="5"/>'
    '<config key="slewmax" value="1"/></instance></plugin>'
)


def arm(**parts: str) -> mujoco.MjModel:
    plain = {"extension": "", "option": "", "floor": 'type="plane" size="5 5 1"', "rod": "", "sensor": ""}
    xml = ARM.format_map({**plain, "motor": '<motor name="lift" joint="elbow"/>', **parts})
    return mujoco.MjModel.from_xml_string(xml)


ON_JAX: tuple[EngineName, ...] = ("mjx", "warp")
SMOOTH = {"rod": 'friction="0 0 0"', "floor": 'type="plane" size="5 5 1" friction="0 0 0"'}


def test_a_plain_model_is_run_by_all() -> None:
    assert [unrun(engine, arm()) for engine in ("native", *ON_JAX)] == [None] * 3


@pytest.mark.parametrize(
    ("parts", "named"),
    [
        (
            {"motor": '<motor name="lift" joint="elbow" delay="0.02" nsample="6"/>'},
            "'lift' acts with a delay",
        ),
        ({"option": 'actuatorgroupdisable="1"'}, "disables groups of actuators"),
        ({"floor": 'type="hfield" hfield="hills"'}, "'floor' is a height field"),
        (
            {
                "extension": '<plugin plugin="mujoco.sensor.touch_grid"/>',
                "rod": '/><site name="tip"',
                "sensor": '<plugin plugin="mujoco.sensor.touch_grid" objtype="site" objname="tip">'
                '<config key="size" value="2 2"/><config key="fov" value="10 10"/>'
                '<config key="gamma" value="0"/><config key="nchannel" value="1"/></plugin>',
            },
            "uses a plugin",
        ),
    ],
)
def test_what_mjx_and_warp_would_leave_out_is_not_run_by_them(parts: dict[str, str], named: str) -> None:
    for engine in ON_JAX:
        assert named in (unrun(engine, arm(**parts)) or "")
        with pytest.raises(JobFailed, match=f"The engine '{engine}' cannot run the model: its? "):
            engine_builder(engine)(arm(**parts), 5, ())
    assert unrun("native", arm(**parts)) is None


@pytest.mark.parametrize("late", ['delay="0.02" nsample="6"', 'interval="0.02" nsample="2"'])
def test_a_late_sensor_keeps_an_engine_only_from_jobs_that_read_it(late: str) -> None:
    model = arm(sensor=f'<jointvel joint="elbow"/><jointpos name="angle" joint="elbow" {late}/>')
    assert {number: set(why) for number, why in unread_by_engine(model).items()} == {
        1: {"mjx", "warp", "compiled"}
    }
    for engine in ON_JAX:
        check_runs(engine, model, ("xpos",))
        with pytest.raises(JobFailed, match="its sensor 'angle' is read late"):
            check_runs(engine, model, ("sensordata",))
    check_runs("native", model, ("sensordata",))


def test_a_controller_by_a_plugin_is_run_by_native_alone() -> None:
    model = arm(extension=PID, motor='<plugin joint="elbow" plugin="mujoco.pid" instance="pid" actdim="1"/>')
    assert ["plugin" in (unrun(engine, model) or "") for engine in ("native", *ON_JAX)] == [False, True, True]


def test_a_job_that_no_engine_can_run_is_refused_and_one_that_some_can_is_not() -> None:
    model = arm()
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_IPC
    why = unrun("native", model) or ""
    assert "bookkeeping" in why
    with pytest.raises(Rejected, match=r"No engine can run it\. it enables"):
        check_physics("auto", dict.fromkeys(("native", "mjx", "warp", "compiled"), why))
    check_physics("auto", dict.fromkeys(("native", "mjx", "warp"), why))


@pytest.mark.parametrize(
    ("change", "is_refused"),
    [
        ({}, True),
        ({"rod": 'friction="1 0 0"'}, False),
        ({"rod": 'friction="1 0 0" priority="1"'}, False),
        ({"rod": 'friction="0 0 0" priority="1"', "floor": 'type="plane" size="5 5 1"'}, True),
        ({"rod": 'friction="0 0 0" condim="1"', "floor": 'type="plane" size="5 5 1" condim="1"'}, False),
        ({"rod": 'friction="0 0 0" contype="0" conaffinity="0"'}, False),
        ({"option": '><flag contact="disable"/></option><option'}, False),
    ],
)
def test_contacts_without_friction_are_not_run_by_warp_nor_by_mjx_under_rk4(
    change: dict[str, str], *, is_refused: bool
) -> None:
    model = arm(**{**SMOOTH, **change})
    assert ("hardly any friction" in (unrun("warp", model) or "")) == is_refused
    assert unrun("mjx", model) is None
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    assert ("hardly any friction" in (unrun("mjx", model) or "")) == is_refused
    assert unrun("native", model) is None


def test_the_larger_friction_of_two_geoms_counts() -> None:
    # What `unrun` supposes about MuJoCo.
    model = arm(**{**SMOOTH, "rod": 'friction="0.5 0 0"'})
    data = mujoco.MjData(model)
    data.qpos[:] = np.pi / 2
    model.body_pos[1, 2] = 0.2
    mujoco.mj_forward(model, data)
    assert data.contact.friction[0, 0] == 0.5
