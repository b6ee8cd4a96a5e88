"""The reacher's row in the catalog."""

from core.environments.info import EnvironmentInfo, NoOptions, Spaces, in_order, named
from core.environments.terms.array_slices import ctrl
from core.environments.terms.inventory import inventory_of
from core.physics.availability import Rule


def _reacher_slices(_: NoOptions) -> Spaces:
    seen = [
        named("cosine", ("joint0", "joint1"), "1", -1.0, 1.0),
        named("sine", ("joint0", "joint1"), "1", -1.0, 1.0),
        named("target_position", ("x", "y"), "m"),
        named("tip_velocity", ("x", "y"), "m/s"),
        named("target_to_tip", ("x", "y", "z"), "m"),
    ]
    return Spaces(in_order(seen), in_order(ctrl(inventory_of("reacher"))))


INFO = EnvironmentInfo(
    id="reacher",
    description="An arm of two links in a plane, rewarded for bringing its tip to a target.",
    factory="core.environments.locomotion.reacher.environment:make",
    observation_size=11,
    action_size=2,
    dt=0.02,
    episode_length=1000,
    tracked_body="body0",
    slices=_reacher_slices,
    on_a_cpu=(Rule("compiled", 1, "Measured on two cores: 1.6 × the training steps/s of native."),),
    on_a_gpu=(Rule("warp", 1024, "Measured on an H200: 921 k training steps/s, 306 k by mjx."),),
)
