"""The sled's row in the catalog."""

from core.environments.info import EnvironmentInfo
from core.physics.availability import Rule

INFO = EnvironmentInfo(
    id="sled",
    description="A mass on a rail with one motor, rewarded for moving in +x.",
    factory="tests.unit.environments.sled.environment:make",
    observation_size=2,
    action_size=1,
    dt=0.02,
    episode_length=100,
    tracked_body="sled",
    on_a_gpu=(Rule("native", 1, "One mass is no work for a GPU."),),
)
