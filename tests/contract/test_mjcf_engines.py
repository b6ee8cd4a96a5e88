"""Terms read the same from every engine; contacts above all, for which engines have no common array."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.environments.environment import State
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from tests.unit.environments.mjcf.probe import XML, options
from tests.unit.environments.mjcf.test_feet import stumbles

TERMS = options(
    reward=[
        {"kind": "contact", "geoms": ["sphere", "rod"]},
        {"kind": "energy", "weight": 0.1},
        {"kind": "velocity_tracking", "velocity": [0.3, 0.4]},
        {"kind": "angular_momentum", "weight": 100.0},
        {"kind": "undesired_contacts", "bodies": ["ball"]},
        {"kind": "foot_slip"},
    ],
    observation=[
        *(
            {"kind": kind}
            for kind in ("qpos", "sensors", "cvel", "body_positions", "foot_contact", "foot_velocity")
        ),
        {"kind": "foot_contact_force", "scale": 0.01},
    ],
    feet=["ball"],
    termination=[{"kind": "contact", "geoms": ["sphere"], "against": "floor"}],
)


def after_a_step(engine: EngineName, folder: Path, heights: tuple[float, ...]) -> list[State]:
    """From each of these heights of the ball, at 0.3 m/s."""
    (folder / "model").write_bytes(XML)
    info = catalog.find("mjcf")
    environment = catalog.make(
        info, catalog.parse_options(info, TERMS), engine_builder(engine), folder / "model"
    )
    start, step = jax.jit(environment.reset)(jax.random.key(0)), jax.jit(environment.step)
    physics = start.physics
    starts = [
        replace(physics, qpos=physics.qpos.at[2].set(height), qvel=physics.qvel.at[0].set(0.3))
        for height in heights
    ]
    return [step(replace(start, physics=one), jnp.array([0.3])) for one in starts]


HOPPING = """
<mujoco>
  <option timestep="0.004"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body pos="0 0 0.35">
      <freejoint/>
      <geom type="box" size="0.1 0.1 0.05" mass="1"/><site name="imu" pos="0.05 0 0.02" euler="10 20 30"/>
      <body pos="0 0.1 0">
        <joint name="hip" axis="0 1 0" damping="0.2" stiffness="5"/>
        <geom name="foot" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.03" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="hip" joint="hip" gear="3" ctrlrange="-1 1"/></actuator>
  <sensor>
    <contact geom1="foot" geom2="floor" data="found"/>
    <accelerometer site="imu"/><actuatorfrc actuator="hip"/><jointactuatorfrc joint="hip"/>
  </sensor>
</mujoco>
"""


def test_contacts_are_counted_in_the_state_that_is_returned_and_accelerations_felt_before_it() -> None:
    """Issue 41: native read contacts after the step and compiled those of the last substep."""
    model = mujoco.MjModel.from_xml_string(HOPPING)
    native, compiled = (engine_builder(name)(model, 5, ("sensordata",)) for name in ("native", "compiled"))
    step = jax.jit(native.step)
    states = [native.reset(jnp.asarray(model.qpos0, jnp.float32), jnp.zeros(model.nv))]
    controls = np.random.default_rng(0).uniform(-1, 1, (60, 1)).astype(np.float32)
    for ctrl in controls:
        states.append(step(states[-1], ctrl))
    before = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states[:-1])
    ours = np.asarray(jax.vmap(compiled.step)(before, jnp.asarray(controls)).derived["sensordata"])
    theirs = np.stack([np.asarray(state.derived["sensordata"]) for state in states[1:]])
    np.testing.assert_array_equal(ours[:, 0], theirs[:, 0])
    np.testing.assert_allclose(ours[:, 1:], theirs[:, 1:], rtol=2e-3, atol=2e-3)
    changes = np.count_nonzero(np.diff(theirs[:, 0]))
    assert changes > 3  # It leaves the floor and meets it again.


# MJX and MuJoCo Warp compile for half a minute each.
SLOW = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.mark.parametrize(
    "engine", [pytest.param("mjx", marks=SLOW), pytest.param("warp", marks=SLOW), "compiled"]
)
def test_every_engine_earns_sees_and_ends_alike(
    engine: EngineName, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if engine == "warp":
        request.getfixturevalue("warp_kernels")
    heights = (0.5, 0.09)
    for native, other in zip(
        after_a_step("native", tmp_path, heights), after_a_step(engine, tmp_path, heights), strict=True
    ):
        np.testing.assert_allclose(other.reward, native.reward, atol=1e-4)
        np.testing.assert_allclose(other.obs, native.obs, atol=1e-4)
        assert float(other.done) == float(native.done)
    assert float(native.done) == 1.0


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("warp_kernels")
def test_warp_tells_the_direction_of_contacts_forces_as_native_does(tmp_path: Path) -> None:
    assert stumbles(tmp_path, "warp", 75) == [[0, 0], [1, 0]]
