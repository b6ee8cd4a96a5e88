"""A planar two-legged body that learns to walk. Rewards as in brax.envs.walker2d."""

from core.environments.locomotion.planar import PlanarWalker
from core.environments.locomotion.walker2d.info import Walker2dOptions
from core.physics.engine import EngineBuilder


def make(options: Walker2dOptions, build_engine: EngineBuilder) -> PlanarWalker:
    """The planar walker under these options, moved by the engine that `build_engine` makes."""
    return PlanarWalker("walker2d", options, build_engine)
