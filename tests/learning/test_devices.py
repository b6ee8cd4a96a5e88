"""Several devices share a run, and it ends where it would have ended on one."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.compiling import compiling_quickly

pytestmark = pytest.mark.extra


@pytest.mark.parametrize(
    ("environment", "engine"),
    [
        ("probe", "none"),
        ("intention", "none"),
        pytest.param("growing", "none", marks=pytest.mark.slow),
        pytest.param("inverted_pendulum", "native", marks=pytest.mark.slow),
        pytest.param("inverted_pendulum", "mjx", marks=pytest.mark.slow),
    ],
)
@pytest.mark.timeout(400)
def test_eight_devices_learn_what_one_learns(environment: str, engine: str, tmp_path: Path) -> None:
    flags = "--xla_force_host_platform_device_count=8"
    compiling = compiling_quickly(flags) if engine == "none" else {"XLA_FLAGS": flags}
    said = subprocess.run(
        [sys.executable, "-m", "tests.learning.on_devices", environment, engine, str(tmp_path)],
        env={**os.environ, **compiling, "JAX_PLATFORMS": "cpu"},
        stdout=subprocess.PIPE,
        check=True,
    )
    answer = json.loads(said.stdout.splitlines()[-1])
    assert answer["devices"] == 8
    # Sums over environments are taken in another order: float32 rounds at 6e-8, and Adam's first steps
    # magnify that where a gradient is all but zero. Another minibatch or random number is 1e-3 and more.
    assert answer["distance"] < 5e-5
    # A checkpoint of one device goes on on eight,
    assert answer["moved_distance"] < 5e-5
    # and with as many devices as it was made on, to the same bits.
    assert answer["resumed_equals"]
