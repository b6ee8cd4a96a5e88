"""What the hopper and the planar walker see and do."""

from core.environments.bodies import body
from core.environments.body_slices import controls, qpos, qvel
from core.environments.spaces import Spaces, in_order

MAX_OBSERVED_SPEED = 10.0


def planar_slices(name: str, hides_x: bool) -> Spaces:
    """name: of the environment. In place of the joint `rootz` stands the torso's height."""
    own = body(name)
    seen = [*qpos(own, range(1) if hides_x else (), {1: "torso height"}), *qvel(own, MAX_OBSERVED_SPEED)]
    return Spaces(in_order(seen), in_order(controls(own)))
