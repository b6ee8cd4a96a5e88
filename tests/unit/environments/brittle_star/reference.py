"""biorobot's own environments, put into states of ours."""

import warnings
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from core.environments.brittle_star.options import DirectedOptions, LightEscapeOptions, Options
from core.environments.dm_control.dm_control_import import without_a_display

TASKS = {
    "brittle_star": ("directed_locomotion", "DirectedLocomotion"),
    "brittle_star_undirected": ("undirected_locomotion", "UndirectedLocomotion"),
    "brittle_star_light_escape": ("light_escape", "LightEscape"),
}


class Draws:
    """biorobot asks this for the seed of its light, and no joint noise."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def randint(self, low: int, high: int) -> int:
        return self._seed

    def uniform(self, low: float, high: float, size: int | None = None) -> Any:
        return 0.5 * (low + high) * np.ones(size or ())


@dataclass
class Reference:
    """One environment on plain MuJoCo, and a state that holds its model and data."""

    environment: Any
    state: Any

    def put(self, qpos: np.ndarray, qvel: np.ndarray, target: np.ndarray | None) -> Any:
        """The environment's own state with these positions and velocities, observed."""
        model, data = self.state.mj_model, self.state.mj_data
        if target is not None:
            model.body("target").pos = target
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, 0
        mujoco.mj_forward(model, data)
        return self.environment._update_observations(self.state)


def reference(task: str, options: Options) -> Reference:
    """biorobot's environment under these options, with its own way from morphology and arena to a model."""
    from importlib import import_module

    folder, name = TASKS[task]
    with without_a_display(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        base = "biorobot.brittle_star"
        module = import_module(f"{base}.environment.{folder}.mjc_env")
        shared = import_module(f"{base}.environment.{folder}.shared")
        default = import_module(f"{base}.mjcf.morphology.specification.default")
        morphology = import_module(f"{base}.mjcf.morphology.morphology")
        aquarium = import_module(f"{base}.mjcf.arena.aquarium")
        noise = {}
        if isinstance(options, LightEscapeOptions):
            noise = {"light_perlin_noise_scale": options.light_perlin_noise_scale}
        environment = getattr(module, f"BrittleStar{name}MJCEnvironment").from_morphology_and_arena(
            morphology=morphology.MJCFBrittleStarMorphology(
                default.default_brittle_star_morphology_specification(
                    num_arms=options.num_arms,
                    num_segments_per_arm=options.num_segments_per_arm,
                    use_p_control=options.actuation == "p_control",
                    use_torque_control=options.actuation == "torque_control",
                )
            ),
            arena=aquarium.MJCFAquariumArena(
                aquarium.AquariumArenaConfiguration(
                    size=options.arena_size,
                    sand_ground_color=isinstance(options, LightEscapeOptions),
                    attach_target=isinstance(options, DirectedOptions),
                )
            ),
            configuration=getattr(shared, f"BrittleStar{name}EnvironmentConfiguration")(
                time_scale=options.time_scale,
                num_physics_steps_per_control_step=options.num_physics_steps_per_control_step,
                simulation_time=options.simulation_time,
                # To the end, as our engine `native` does; biorobot's own are 1 and 5.
                solver_iterations=100,
                solver_ls_iterations=50,
                **noise,
            ),
        )
        seed = options.light_seed if isinstance(options, LightEscapeOptions) else 0
        state = environment.reset(Draws(seed))
    # On plain MuJoCo its directed tasks lift the disk off its free joint; under MJX they lift the joint.
    state.mj_model.body("BrittleStarMorphology/central_disk").pos[:] = 0
    return Reference(environment, state)
