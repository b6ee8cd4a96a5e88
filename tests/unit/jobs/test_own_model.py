"""Which engines a job's model rules out."""

from core.environments.mjcf.info import MjcfOptions
from core.environments.mjcf.inventory import Sensor
from core.jobs.resolved import engines_that_cannot
from tests.contract.test_job_store import DESCRIPTION

SENSORS = [
    Sensor(name="imu", type="force", size=3, beyond={"compiled": "its sensor 'imu' is of the kind force"}),
    Sensor(name="angle", type="jointpos", size=1),
]


def test_a_sensor_counts_against_an_engine_where_the_job_reads_it() -> None:
    """Issue 41: an explicit `compiled` was a 202 that failed as `bad_model`."""
    inventory = DESCRIPTION.inventory.model_copy(update={"sensors": SENSORS})
    described = DESCRIPTION.model_copy(update={"inventory": inventory})

    def cannot(observation: list[dict[str, object]]) -> dict[str, str]:
        options = MjcfOptions.model_validate({"model": f"sha256:{'0' * 64}", "observation": observation})
        return dict(engines_that_cannot(described, options))

    assert cannot([{"kind": "qpos"}]) == {"mjx": "No."}
    assert cannot([{"kind": "sensors", "names": ["angle"]}]) == {"mjx": "No."}
    for reads in ({"kind": "sensors", "names": ["imu"]}, {"kind": "sensors"}):
        assert cannot([reads])["compiled"].startswith(
            "The engine 'compiled' cannot run the model: its sensor 'imu' is of the kind force."
        )
