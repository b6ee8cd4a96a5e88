"""The library as its users have it: its step beside C MuJoCo's, and what its names load."""

import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import mujoco_compiled
from mujoco_compiled import Uncovered, forward, make_data, put_data, put_model, step

BODY = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body name="ball" pos="0 0 0.12">
      <freejoint/>
      <geom size="0.1"/>
      <body pos="0.1 0 0">
        <joint name="hinge" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <general name="drive" joint="hinge" dyntype="filter" dynprm="0.05" gainprm="2" ctrlrange="-1 1"/>
  </actuator>
  <sensor><clock/><actuatorfrc actuator="drive"/></sensor>
</mujoco>
"""
POLE = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body pos="0 0 1"><joint name="hinge" axis="0 1 0"/><geom pos="0 0 -0.3" size="0.1"/></body>
  </worldbody>
  <actuator><motor joint="hinge"/></actuator>
</mujoco>
"""
DERIVED = ("xpos", "sensordata", "qfrc_actuator")


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(BODY)


def moving(model: mujoco.MjModel) -> mujoco.MjData:
    """A state in which every field counts."""
    data = mujoco.MjData(model)
    data.qvel[:] = np.linspace(-0.5, 0.5, model.nv)
    data.act[:], data.ctrl[:], data.time = 0.3, 0.8, 0.25
    mujoco.mj_forward(model, data)
    return data


def assert_close(ours: mujoco_compiled.Data, data: mujoco.MjData, names: tuple[str, ...]) -> None:
    for name in names:
        np.testing.assert_allclose(
            getattr(ours, name), getattr(data, name), rtol=2e-4, atol=2e-4, err_msg=name
        )


def test_a_step_is_that_many_steps_of_mujoco(model: mujoco.MjModel) -> None:
    data, m = moving(model), put_model(model, nstep=4, derived=DERIVED)
    after = jax.jit(step)(m, put_data(m, data))
    mujoco.mj_step(model, data, nstep=4)
    assert_close(after, data, ("qpos", "qvel", "act", "ctrl", "time", "qfrc_actuator"))
    mujoco.mj_forward(model, data)
    assert_close(after, data, ("xpos",))


def test_forward_computes_what_was_asked_for_under_the_states_controls_and_moves_nothing(
    model: mujoco.MjModel,
) -> None:
    data, m = moving(model), put_model(model, derived=DERIVED)
    found = jax.jit(forward)(m, put_data(m, data).replace(xpos=None, sensordata=None, qfrc_actuator=None))
    assert_close(found, data, ("qpos", "qvel", "act", "time", *DERIVED))
    assert found.xquat is None
    assert make_data(m).qpos.tolist() == [float(np.float32(x)) for x in model.qpos0]


def test_environments_may_have_fields_of_the_model_for_themselves(model: mujoco.MjModel) -> None:
    m, d = put_model(model), put_data(put_model(model), moving(model))
    gravity = jnp.array([[0.0, 0.0, -9.81], [0.0, 0.0, 0.0], [1.0, 0.0, -9.81]])
    after = jax.jit(jax.vmap(step, in_axes=(0, None)))(m.tree_replace({"opt.gravity": gravity}), d)
    for one, own in zip(after.qvel, gravity, strict=True):
        changed, data = mujoco.MjModel.from_xml_string(BODY), moving(model)
        changed.opt.gravity = own
        mujoco.mj_step(changed, data)
        np.testing.assert_allclose(one, data.qvel, rtol=1e-4, atol=1e-4)
    with pytest.raises(ValueError, match="cannot differ in \\['nbody'\\]"):
        m.tree_replace({"nbody": jnp.zeros(())})


def test_what_is_not_covered_is_refused_by_its_element(model: mujoco.MjModel) -> None:
    with pytest.raises(Uncovered, match="qacc is not a derived field"):
        put_model(model, derived=("qacc",))
    rocky = BODY.replace('timestep="0.005"', 'integrator="RK4"')
    with pytest.raises(Uncovered, match="its integrator is rk4"):
        put_model(mujoco.MjModel.from_xml_string(rocky))


def test_a_model_that_changes_afterwards_changes_nothing() -> None:
    model = mujoco.MjModel.from_xml_string(BODY)
    m = put_model(model)
    model.opt.gravity[:] = 0.0
    after = step(m, make_data(m))
    assert float(after.qvel[2]) == pytest.approx(-9.81 * 0.005, rel=1e-4)


@pytest.mark.parametrize(
    ("names", "unneeded"),
    [
        ((), {"jax", "llvmlite", "mujoco", "numpy"}),
        (("uncovered", "unread_sensors", "pairs_of_geoms"), {"jax", "llvmlite"}),
    ],
    ids=["nothing", "coverage"],
)
def test_a_name_loads_no_more_than_it_needs(names: tuple[str, ...], unneeded: set[str]) -> None:
    program = (
        "import sys, mujoco_compiled\n"
        f"for name in {names!r}: getattr(mujoco_compiled, name)\n"
        f"print(sorted({unneeded!r} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_all_names_are_there_and_no_other() -> None:
    assert all(hasattr(mujoco_compiled, name) for name in mujoco_compiled.__all__)
    assert not hasattr(mujoco_compiled, "unknown")


def test_the_readmes_program_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("body.xml").write_text(POLE)
    exec(readmes_program(), {})  # noqa: S102
    check_told(capsys.readouterr().out)


def check_told(told: str) -> None:
    """The program's output for a pole that hangs, and is damped."""
    time, *positions = map(float, re.findall(r"-?\d+\.?\d*", told))
    assert time == pytest.approx(2.5)
    assert positions == pytest.approx([0, 0, 0, 0, 0, 1], abs=1e-6)


def readmes_program() -> str:
    """The first program of the library's page."""
    page = Path(mujoco_compiled.__file__).with_name("README.md").read_text()
    return page.partition("```python\n")[2].partition("```")[0]
