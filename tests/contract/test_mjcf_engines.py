"""Terms read the same from every engine; contacts above all, for which engines have no common array."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.environments import catalog
from core.environments.environment import State
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from tests.unit.environments.mjcf.probe import XML, options

TERMS = options(
    reward=[
        {"kind": "contact", "geoms": ["sphere", "rod"]},
        {"kind": "energy", "weight": 0.1},
        {"kind": "velocity_tracking", "velocity": [0.3, 0.4]},
    ],
    observation=[{"kind": "qpos"}, {"kind": "sensors"}, {"kind": "cvel"}, {"kind": "body_positions"}],
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
