"""Actuators that act late, beside C MuJoCo's."""

import jax
import mujoco
import numpy as np
import pytest

from mujoco_compiled.coverage import Uncovered
from mujoco_compiled.data import Data, make_data, put_data, step
from mujoco_compiled.model import Model, put_model
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.smooth.delays import read_late
from mujoco_compiled.write import Plan, control_step_in_lanes, control_step_program

TIMESTEP = 0.002
LEG = """
<body pos="{0} {1} 0"><joint name="hip {0} {1}" axis="0 1 0" damping="0.3" armature="0.01"/>
  <geom type="capsule" size="0.03" fromto="0 0 0 0.1 0 -0.2" mass="0.2" contype="0" conaffinity="0"/></body>
"""
PLACES = [(x, y) for x in (-0.2, 0.2) for y in (-0.1, 0.1)]


def late(*attributes: str) -> mujoco.MjModel:
    """Four limbs, each with a servo with some of these attributes, in turn."""
    legs = "".join(LEG.format(*place) for place in PLACES)
    servos = "".join(
        f'<position joint="hip {x} {y}" kp="20" kv="0.5" {attributes[k % len(attributes)]}/>'
        for k, (x, y) in enumerate(PLACES)
    )
    return mujoco.MjModel.from_xml_string(f"""
      <mujoco><option timestep="{TIMESTEP}"/><worldbody>
        <body pos="0 0 1"><freejoint/><geom type="box" size="0.2 0.1 0.05" mass="3"/>{legs}</body>
      </worldbody><actuator>{servos}</actuator></mujoco>
    """)


# Cubic splines are MuJoCo's, with slopes by the neighbours: -1/16, 9/16, 9/16, -1/16 half-way.
@pytest.mark.parametrize(
    ("attributes", "weights"),
    [
        ('delay="0.006" nsample="5"', [0, 0, 1, 0, 0]),
        ('delay="0.007" nsample="5"', [0, 1, 0, 0, 0]),
        ('delay="0.0005" nsample="3"', [0, 0, 1]),
        ('delay="1" nsample="3"', [1, 0, 0]),
        ('delay="0.0065" nsample="5" interp="linear"', [0, 0.25, 0.75, 0, 0]),
        ('delay="0.005" nsample="4" interp="cubic"', [-1 / 16, 9 / 16, 9 / 16, -1 / 16]),
    ],
)
def test_what_acts_is_a_sum_of_the_last_controls(attributes: str, weights: list[float]) -> None:
    found = read_late(late(attributes))
    assert list(found) == [0, 1, 2, 3]
    for number, one in found.items():
        assert one.first == number * len(weights)
        np.testing.assert_allclose(one.weights, weights, atol=1e-9)


def test_a_delay_of_whole_time_steps_is_that_many() -> None:
    model = late('delay="0.02" nsample="10"')
    model.opt.timestep = 0.005
    # Steps of 5 ms are not exact in binary, so that MuJoCo itself reads the fifth control in many of them.
    assert read_late(model)[0].weights == (0.0,) * 6 + (1.0,) + (0.0,) * 3


MIXED = late(
    'delay="0.007" nsample="6" ctrllimited="true" ctrlrange="-0.8 0.8"',
    'delay="0.0065" nsample="5" interp="linear"',
    "",
    'delay="0.009" nsample="8" interp="cubic"',
)


def moved(model: mujoco.MjModel, num_steps: int, seed: int) -> mujoco.MjData:
    data, generator = mujoco.MjData(model), np.random.default_rng(seed)
    for _ in range(num_steps):
        data.ctrl[:] = generator.uniform(-1.0, 1.0, size=model.nu)
        mujoco.mj_step(model, data)
    return data


def stepped(m: Model, d: Data, model: mujoco.MjModel, data: mujoco.MjData) -> Data:
    """Both, under other controls every two time steps."""
    generator, move = np.random.default_rng(7), jax.jit(step)
    for _ in range(20):
        ctrl = generator.uniform(-1.0, 1.0, size=model.nu).astype(np.float32)
        d = move(m, d.replace(ctrl=ctrl))
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data, 2)
    return d


@pytest.mark.parametrize("num_steps", [0, 13], ids=["from the start", "from a state of MuJoCo's"])
def test_late_servos_move_as_in_mujoco(num_steps: int) -> None:
    data, m = moved(MIXED, num_steps, seed=0), put_model(MIXED, nstep=2)
    d = stepped(m, put_data(m, data), MIXED, data)
    for name in ("qpos", "qvel"):
        np.testing.assert_allclose(getattr(d, name), getattr(data, name), rtol=2e-5, atol=2e-5, err_msg=name)
    np.testing.assert_allclose(d.history, put_data(m, data).history, atol=1e-6)


def test_a_state_goes_on_from_its_history() -> None:
    m = put_model(MIXED, nstep=2)
    first = stepped(m, make_data(m), MIXED, mujoco.MjData(MIXED))
    kept = jax.tree.map(np.array, first)
    for one, other in zip(
        *(jax.tree.leaves(jax.jit(step)(m, begun)) for begun in (first, kept)), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    forgot = jax.jit(step)(m, first.replace(history=make_data(m).history))
    assert np.abs(np.array(forgot.qvel - jax.jit(step)(m, first).qvel)).max() > 1e-2


def test_a_history_of_other_times_is_refused() -> None:
    data, m = mujoco.MjData(MIXED), put_model(MIXED)
    data.time = 1.0
    with pytest.raises(Uncovered, match="the controls in `history` are not those of the last time steps"):
        put_data(m, data)


def test_limbs_with_late_servos_are_shared_out() -> None:
    model = late('delay="0.0065" nsample="5" interp="linear"')
    data = moved(model, 11, seed=3)
    d = put_data(put_model(model), data)
    names = ("qpos", "qvel", "qacc_warmstart", "ctrl", "history")
    given = {name: [np.array([float(x)]) for x in np.ravel(getattr(d, name))] for name in names}
    plan = Plan(model, {name: len(values) for name, values in given.items()}, (), ())
    in_lanes, whole = control_step_in_lanes(plan, 3), control_step_program(plan, 3)
    assert in_lanes.num_lanes == 4
    found, expected = interpret(in_lanes, given), interpret(whole, given)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-9, atol=1e-9, err_msg=name)
