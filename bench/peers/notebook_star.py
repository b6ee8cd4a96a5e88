"""The tutorial notebook's own loop, rebuilt: `python -m bench.peers.notebook_star FOLDER`.

One brittle star in biorobot's MJX environment; a Q-table chooses its leading arm at every control step, a CPG
(Euler, one step for each control step) turns that into joint angles; the episode is one compiled program, and
the table learns from it afterwards, step by step in another. Needs the packages biorobot and moojoco.

Request: steps (control steps in a compiled episode; the notebook's are 499), time_limit_s (no episode starts
after this many seconds of episodes, except the first two), seed, device (`cpu`, the default, or `gpu`);
num_arms and num_segments_per_arm (default: the notebook's 5 and 5); solver (default: biorobot's own [1, 5]
iterations and line searches); cache (a folder for compiled programs, or null).
"""

import math
import os
import time
from typing import Any

from bench.measure.child import answer

_ALPHA, _GAMMA, _EPSILON = 0.1, 0.99, 0.3
_COUPLING, _GAIN, _OMEGA = 5.0, 20.0, math.pi
_SUBSTEPS, _TIME_SCALE, _EPISODE_S = 10, 2, 20


def work(request: dict[str, Any]) -> dict[str, Any]:
    """control_steps_per_second: of episodes and learning after the first call; episodes and seconds: how
    many those were, and how long; compile_s: of the episode; control_steps: in each episode;
    num_physics_steps: in each control step; episode_reward: the mean; finite: whether all numbers are."""
    import jax
    import jax.numpy as jnp

    from bench.measure.turn import Turn

    if request.get("cache"):
        jax.config.update("jax_compilation_cache_dir", request["cache"])
    num_arms, steps = request.get("num_arms", 5), request["steps"]
    environment = star(num_arms, request.get("num_segments_per_arm", 5), request.get("solver", [1, 5]))
    learn = jax.jit(_learn)
    key, table_key = jax.random.split(jax.random.PRNGKey(request.get("seed", 0)))
    table = jax.random.uniform(table_key, (num_arms, num_arms), minval=-0.001, maxval=0.001)
    began = time.perf_counter()
    episode = jax.jit(_episode(environment, num_arms, steps)).lower(key, table).compile()
    compile_s = time.perf_counter() - began

    def once(table: Any, key: Any) -> tuple[Any, float, float]:
        began = time.perf_counter()
        samples = episode(key, table)
        table = jax.block_until_ready(learn(table, samples))
        return table, float(jnp.sum(samples[-1])), time.perf_counter() - began

    rewards, spent = list[float](), list[float]()
    with Turn():
        while len(spent) < 2 or sum(spent[1:]) < request["time_limit_s"]:
            key, now = jax.random.split(key)
            table, reward, seconds = once(table, now)
            rewards.append(reward)
            spent.append(seconds)
    del spent[0]  # It compiled the learning program.
    return {
        "control_steps_per_second": steps * len(spent) / sum(spent),
        "episodes": len(spent),
        "seconds": sum(spent),
        "compile_s": compile_s,
        "control_steps": steps,
        "num_physics_steps": _SUBSTEPS,
        "episode_reward": sum(rewards) / len(rewards),
        "finite": bool(jnp.isfinite(table).all()) and math.isfinite(sum(rewards)),
        "device": jax.devices()[0].device_kind,
    }


def star(num_arms: int, num_segments_per_arm: int, solver: list[int]) -> Any:
    """biorobot's environment of directed locomotion under MJX, with the notebook's settings."""
    # Otherwise dm_control looks for a display.
    os.environ.setdefault("MUJOCO_GL", "egl")
    from biorobot.brittle_star.environment.directed_locomotion.mjx_env import (
        BrittleStarDirectedLocomotionMJXEnvironment as Environment,
    )
    from biorobot.brittle_star.environment.directed_locomotion.shared import (
        BrittleStarDirectedLocomotionEnvironmentConfiguration as Configuration,
    )
    from biorobot.brittle_star.mjcf.arena.aquarium import AquariumArenaConfiguration, MJCFAquariumArena
    from biorobot.brittle_star.mjcf.morphology.morphology import MJCFBrittleStarMorphology
    from biorobot.brittle_star.mjcf.morphology.specification.default import (
        default_brittle_star_morphology_specification as morphology,
    )

    body = morphology(
        num_arms=num_arms,
        num_segments_per_arm=num_segments_per_arm,
        use_p_control=True,
        use_torque_control=False,
    )
    arena = AquariumArenaConfiguration(
        size=(10, 5), sand_ground_color=False, attach_target=True, wall_height=1.5, wall_thickness=0.1
    )
    configuration = Configuration(
        joint_randomization_noise_scale=0.0,
        simulation_time=_EPISODE_S,
        num_physics_steps_per_control_step=_SUBSTEPS,
        time_scale=_TIME_SCALE,
        solver_iterations=solver[0],
        solver_ls_iterations=solver[1],
    )
    return Environment.from_morphology_and_arena(
        MJCFBrittleStarMorphology(body), MJCFAquariumArena(arena), configuration
    )


def _episode(environment: Any, num_arms: int, steps: int) -> Any:
    """Maps a key and a table to samples [steps] of sector, action, next sector and reward."""
    import jax
    import jax.numpy as jnp

    from core.environments.cpg import star as network
    from core.environments.cpg.integration import advance
    from core.environments.cpg.oscillators import Network, at_rest, output
    from core.environments.cpg.roles import Gait, modulation, roles_under

    coupled = Network(jnp.asarray(network.weights(num_arms, _COUPLING)), _GAIN, _GAIN)
    dt = environment.environment_configuration.control_timestep
    limit = float(environment.frozen_mj_model.actuator_ctrlrange[:, 1].min()) / 2
    gait = Gait(_OMEGA, limit, limit, limit)
    segments = environment.frozen_mj_model.nu // (2 * num_arms)

    def sector(observations: Any) -> Any:
        """The arm that points most nearly at the target."""
        x, y = observations["unit_xy_direction_to_target"]
        angle = jnp.arctan2(y, x) - observations["disk_rotation"][-1]
        return jnp.round(angle * num_arms / (2 * jnp.pi)).astype(jnp.int32) % num_arms

    def run(key: Any, table: Any) -> Any:
        key, reset_key, phase_key = jax.random.split(key, 3)
        phases = jax.random.uniform(phase_key, (2 * num_arms,), minval=-0.01, maxval=0.01)

        def step(carry: Any, key: Any) -> Any:
            state, oscillators = carry
            seen = sector(state.observations)
            explores, arm = jax.random.split(key)
            greedy = jax.random.uniform(explores) >= _EPSILON
            chosen = jnp.where(greedy, jnp.argmax(table[seen]), jax.random.randint(arm, (), 0, num_arms))
            wanted = modulation(roles_under(chosen, num_arms), gait)
            oscillators = advance(coupled, wanted, oscillators, dt, "euler")
            arms = output(oscillators).reshape(num_arms, 2)
            state = environment.step(state, jnp.repeat(arms, segments, axis=0).reshape(-1))
            sample = (seen, chosen, sector(state.observations), state.reward)
            return (_settled(state), oscillators), sample

        first = (_settled(environment.reset(reset_key)), at_rest(phases))
        return jax.lax.scan(step, first, jax.random.split(key, steps))[1]

    return run


def _learn(table: Any, samples: Any) -> Any:
    """The table after one sample after the other (Watkins, 1989)."""
    import jax
    import jax.numpy as jnp

    def update(table: Any, sample: Any) -> Any:
        seen, chosen, seen_next, reward = sample
        wanted = reward + _GAMMA * jnp.max(table[seen_next])
        return table.at[seen, chosen].add(_ALPHA * (wanted - table[seen, chosen])), None

    return jax.lax.scan(update, table, samples)[0]


def _settled(state: Any) -> Any:
    """The state as arrays: moojoco starts with Python's numbers and returns arrays, which a scan refuses."""
    import jax.numpy as jnp

    return state.replace(
        reward=jnp.float32(state.reward),
        terminated=jnp.bool_(state.terminated),
        truncated=jnp.bool_(state.truncated),
    )


if __name__ == "__main__":
    answer(work)
