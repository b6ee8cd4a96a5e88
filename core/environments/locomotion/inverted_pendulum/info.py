"""The inverted pendulum's row in the catalog."""

from core.environments.info import EnvironmentInfo
from core.physics.availability import Rule

INFO = EnvironmentInfo(
    id="inverted_pendulum",
    description="A pole on a cart with one motor, rewarded for each step in which the pole stands.",
    factory="core.environments.locomotion.inverted_pendulum.environment:make",
    observation_size=4,
    action_size=1,
    dt=0.04,
    episode_length=1000,
    tracked_body="cart",
    on_a_gpu=(Rule("warp", 1024, "Measured on an H200: 1.54 M training steps/s, 635 k by mjx."),),
)
