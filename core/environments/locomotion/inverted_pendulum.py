"""A pole balanced on a cart. Source: Barto et al., 1983; rewards as in brax.envs.inverted_pendulum."""

from core.environments.info import NoOptions
from core.environments.terms.page import noisy, page
from core.environments.terms.rewards import Alive
from core.environments.terms.task import TaskOptions
from core.environments.terms.terminations import OutsideJointRange
from core.physics.availability import Rule


def _task(_: NoOptions) -> TaskOptions:
    return TaskOptions(
        reward=[Alive()],
        # Brax bounds the hinge's angle, in radians.
        termination=[OutsideJointRange(joints=["hinge"], range=(-0.2, 0.2))],
        metrics=[],
        reset=noisy(0.01),
        n_frames=2,
    )


INVERTED_PENDULUM = page(
    "inverted_pendulum",
    "core.environments.locomotion.model:plain",
    _task,
    NoOptions,
    description="A pole on a cart with one motor, rewarded for each step in which the pole stands.",
    # As in Brax: there is one term, which is the reward itself.
    reports={"reports_rewards": False},
    on_a_gpu=(Rule("warp", 1024, "Measured on an H200: 1.54 M training steps/s, 635 k by mjx."),),
)
