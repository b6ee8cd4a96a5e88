"""The simulation of a walker in its corridor, for programs that have MuJoCo alone (docs/push.md)."""

from collections.abc import Iterator

import mujoco

from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.options import in_order
from core.environments.dm_control.corridor.walkers import WALKERS
from core.environments.simulation import OBSTACLES_AHEAD, Ends, NotSimulated, Numbers, numbers, rows

# The numbers of a body in MuJoCo's arrays.
_ROW = {"cinert": 10, "cvel": 6}


def check_can_be_pushed(options: CorridorOptions) -> None:
    """Raises NotSimulated where a program would need more than MuJoCo and the corridor's obstacles."""
    refusals = {
        "each episode has another corridor": options.has_layouts,
        "it sees by a camera": options.egocentric_depth > 0,
        "contacts end its episodes": options.contact_termination,
        "its actions are added to the controls that hold its start": options.counts_from_start,
    }
    for why, is_so in refusals.items():
        if is_so:
            raise NotSimulated(why)


def observation(options: CorridorOptions, model: mujoco.MjModel, bodies: slice) -> Iterator[Numbers]:
    """The parts of the observation, in their order. bodies: those of the walker."""
    hidden = 2 if options.exclude_current_positions_from_observation else 0
    yield numbers("qpos", range(hidden, model.nq))
    yield numbers("qvel", range(model.nv))
    for name in in_order(options.observables):
        if name == "qfrc_actuator":
            yield numbers(name, range(model.nv))
        else:
            yield rows(name, range(bodies.start, bodies.stop), _ROW[name])
    yield numbers(OBSTACLES_AHEAD, range(3 * options.num_next_obstacles))


def ends(options: CorridorOptions, model: mujoco.MjModel, trunk: int, *, ground: float) -> Iterator[Ends]:
    """When episodes end. ground: the height below which the trunk has fallen, in m."""
    height = rows("xpos", [trunk], 3, [2])
    yield Ends(height, ground, None)
    if options.terminate_when_unhealthy:
        yield Ends(height, *options.healthy_range)
    if options.terminate_at_height is not None:
        feet = [model.body(name).id for name in WALKERS[options.walker].end_effectors]
        yield Ends(rows("xpos", feet, 3, [2]), options.terminate_at_height, None)
