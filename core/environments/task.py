"""An environment made of a model and of terms."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Self

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.action_to_control import ActionToControl
from core.environments.deployment import Deployment, NotDeployed, deployment
from core.environments.environment import TRUNCATED, State
from core.environments.episode_chance import Chance, CommandSampler, Events, Purpose
from core.environments.episode_start import RandomStart, first_motion, first_positions
from core.environments.mujoco_env import MujocoEnv, initial, noisy_start
from core.environments.reference.parts import Parts, Record
from core.environments.reference.playback import FIRST_FRAME, FRAME, Playback
from core.environments.simulated_model import NotSimulated
from core.environments.simulation import Simulation, simulation_of
from core.environments.task_model import solver_settings
from core.environments.task_terms import TaskTerms
from core.environments.terms.actions import of_the_body
from core.environments.terms.commands import PositionCommand, VelocityCommand
from core.environments.terms.describe import root_of
from core.environments.terms.feet import feet_of
from core.environments.terms.followed import Followed
from core.environments.terms.inventory import Inventory
from core.environments.terms.memory import StepMemory
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.reference import compared_bodies
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.task import TaskOptions, num_substeps, observed, parts_of, placed_terms
from core.environments.terrain.grid import TerrainGrid
from core.environments.trajectory import FollowedClip
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, SolverSettings

# Folded into a reset's key, as `episode_chance` folds in 7.
_OF_THE_TERRAIN, _OF_THE_REFERENCE, _OF_THE_START = 8, 9, 11


@dataclass(frozen=True)
class TaskSettings:
    """solver: for engines on which the solver is expensive; None: the model's own. aliases, reports_rewards:
    see MujocoEnv. clips: the files of the reference, by their ids."""

    solver: SolverSettings | None
    aliases: Mapping[str, str] = field(default_factory=dict[str, str])
    reports_rewards: bool = True
    clips: Mapping[str, Path] = field(default_factory=dict[str, Path])


class TaskEnv(MujocoEnv):
    """Reward: the weighted sum of the terms. An episode ends when one of the termination terms says so.

    settings: None: the solver's are those of the options.
    """

    def __init__(
        self,
        options: TaskOptions,
        parts: Inventory,
        spec: mujoco.MjSpec,
        model: mujoco.MjModel,
        build_engine: EngineBuilder,
        settings: TaskSettings | None = None,
    ) -> None:
        settings = settings or TaskSettings(solver_settings(options))
        # A decoder stands outside: see `core.environments.wrappers.decoded`.
        options = options.model_copy(update={"action": of_the_body(options.action)})
        named = _indexed(options, parts, model)
        self._command = None
        if options.command is not None:
            self._command = CommandSampler(options.command, named)
            named = replace(named, num_targets=self._command.num_targets)
        self._events = Events(options.events, named)
        frames = num_substeps(options, model.opt.timestep)
        dt = frames * model.opt.timestep
        self._terms = TaskTerms(options, parts, named, dt)
        policy = self._terms.policy
        self.action_to_control = ActionToControl(options.action, named, policy, dt)
        self._playback = None
        if options.reference is not None:
            self._playback = Playback.of(options.reference, named, dt, settings.clips)
        self._options, self._memory = options, StepMemory(options.memory, named)
        reading = [self._terms, self._memory, self._events, self.action_to_control]
        reading += [self._command] if self._command else []
        fields = sorted({name for part in reading for name in part.derived})
        engine = build_engine(model, frames, tuple(fields), accelerated=settings.solver)
        super().__init__(model, engine, num_substeps=frames, observation_size=0, tracked_body=named.root)
        self.aliases, self.reports_rewards = settings.aliases, settings.reports_rewards
        self.action_size = named.num_actions
        self._lift = np.zeros(model.nq, np.float32)
        if (free := named.free_joint(named.root)) is not None:
            self._lift[free + 2] = options.reset.lift
        self.initial_qpos = jnp.asarray(named.pose, jnp.float32) + self._lift
        self.initial_qvel, self.initial_act = first_motion(model, options.reset)
        self._spec, self._parts, self._inventory = spec, named, parts
        self._grid = None
        if options.terrain is not None:
            self._grid = TerrainGrid(options.terrain, named)
        is_moved = options.reset.moves_root or options.reset.joints is not None
        self._start = RandomStart(options.reset, named) if is_moved else None
        is_random = bool(options.command or options.gait or options.events)
        is_random |= policy.is_random or self.action_to_control.is_random
        self._chance = Chance(dt, is_needed=is_random)
        self.observation_size = self._terms.observation_size

    def reset(
        self, key: jax.Array, model: ModelFields = NOMINAL, *, command: jax.Array | None = None
    ) -> State:
        """command: [m], in place of a random one's first numbers; of a task with commands."""
        reset, options = self._options.reset, self._options
        there, model, info = self._begun(key, model)
        physics = noisy_start(
            there,
            key,
            model,
            reset.position_noise,
            velocity_scale=reset.velocity_noise,
            normal_velocity=reset.velocity_distribution == "normal",
        )
        nothing = jnp.zeros(self.action_size)
        step = Step(physics, physics, nothing, nothing, self.dt, jnp, control=nothing)
        step = self._with_reference(self._grounded(step, info), info)
        step, remembered = self._memory.begun(step)
        info |= remembered | self._chance.begun(key)
        if self._command is not None:
            info |= self._command.begun(step, info, self._chance)
            if command is not None:
                info["command"] = jnp.concatenate([command, info["command"][command.size :]])
        if options.gait:
            info["phase"] = self._chance.uniform(info, 1, Purpose.GAIT)[0]
        info |= self._terms.policy.drawn(partial(self._chance.uniform, info, purpose=Purpose.OBSERVATION))
        info |= self.action_to_control.begun(partial(self._chance.uniform, info, purpose=Purpose.ACTION))
        step = replace(step, command=info.get("command"), target=info.get("target"))
        return initial(self._after(step, info))

    def placed(self, key: jax.Array, qpos: jax.Array, qvel: jax.Array) -> tuple[jax.Array, jax.Array]:
        if self._start is None or self._chance.is_left_out:
            return qpos, qvel
        return self._start.placed(jax.random.fold_in(key, _OF_THE_START), qpos, qvel)

    def step(self, state: State, action: jax.Array) -> State:
        info = {**state.info, **self._chance.stepped(state.info)}
        nothing, command, target = jnp.zeros(self.action_size), info.get("command"), info.get("target")
        untouched = Step(state.physics, state.physics, nothing, nothing, self.dt, jnp, command, target)
        beginning = self._events.applied(untouched, info, self._chance)
        reference = None
        if self._playback is not None:
            info[FRAME] = info[FRAME] + 1
            reference, _ = self._playback.state(info[FRAME])
        control, entries = self.action_to_control.controls(action, beginning, info, reference)
        info |= entries
        physics = self.action_to_control.stepped(self.engine, beginning.after, control)
        step = replace(beginning, after=physics, action=action, control=control)
        step = self._with_reference(self._grounded(step, info), info)
        step, remembered = self._memory.after(step, info)
        info |= remembered
        if self._grid is not None:
            is_velocity = isinstance(self._options.command, VelocityCommand)
            info |= self._grid.stepped(step, info, step.command if is_velocity else None)
        if (gait := self._options.gait) is not None:
            info["phase"] = (info["phase"] + gait.frequency * self.dt) % 1.0
        if self._command is not None:
            # `step` keeps the command that its action knew, and is judged by that.
            info |= self._command.stepped(step, info, self._chance)
        return self._after(step, info)

    @property
    def recorded(self) -> Mapping[str, str]:
        """See `HasCommand`."""
        of_reference = {} if self._playback is None else {"reference_frame": FRAME}
        match self._options.command:
            case VelocityCommand():
                return {"command": "command", **of_reference}
            case PositionCommand():
                return {"target": "target", **of_reference}
            case _:
                return of_reference

    @property
    def terrain_levels(self) -> TerrainGrid | None:
        return self._grid if self._grid is not None and self._grid.has_curriculum else None

    def at_terrain_cell(self, cell: jax.Array) -> "TaskEnv":
        there = copy.copy(self)
        there._grid = self._grid and self._grid.at_cell(cell)
        return there

    @property
    def clips(self) -> Sequence[FollowedClip]:
        """See `HasClips`."""
        return () if self._playback is None else self._playback.clips

    def reference_positions(self, frames: np.ndarray) -> np.ndarray:
        """See `HasClips`."""
        return self._followed_playback.positions(frames)

    @property
    def adaptive_parts(self) -> Parts | None:
        """See `HasClipParts`."""
        return None if self._playback is None else self._playback.adaptive_parts

    def under_record(self, record: Record) -> "TaskEnv":
        there = copy.copy(self)
        there._playback = self._followed_playback.under_record(record)
        return there

    @property
    def playback(self) -> Playback | None:
        """The reference's frames; None without a reference."""
        return self._playback

    @property
    def _followed_playback(self) -> Playback:
        if self._playback is None:
            raise ValueError("The task follows no reference.")
        return self._playback

    @property
    def compared(self) -> tuple[Sequence[str], Sequence[str]]:
        """The names of the joints and of the bodies whose distances `reference_errors` has."""
        reference, parts = self._options.reference, self._inventory
        joints = [joint.name for joint in parts.moving_joints()]
        return joints, [] if reference is None else compared_bodies(reference, parts)

    def reference_errors(self, state: State) -> tuple[jax.Array, jax.Array]:
        """How far the joints [joints], in rad or m, and the compared bodies [bodies], in m, are from where
        they are to be in a state, which has all of `FollowedReference`."""
        nothing, followed = jnp.zeros(self.action_size), self._parts.followed
        step = Step(state.physics, state.physics, nothing, nothing, self.dt, jnp)
        step = self._with_reference(step, state.info)
        away = followed.offsets(step, followed.compared)
        return jnp.abs(followed.joint_offsets(step)), jnp.linalg.norm(away, axis=-1)

    def at_frame(self, row: jax.Array) -> "TaskEnv":
        """The environment whose episodes begin at this row [] int32 of the reference's frames."""
        there = copy.copy(self)
        there._playback = self._followed_playback.at_frame(row)
        return there

    def _begun(
        self, key: jax.Array, model: ModelFields
    ) -> tuple["TaskEnv", ModelFields, dict[str, jax.Array]]:
        """The environment that begins where the episode does, the fields of the model, and entries of
        `info`."""
        if self._playback is None:
            return self._on_terrain(key, model)
        there, info = self._in_a_clip(self._playback, key)
        return there, model, info

    def _in_a_clip(self, playback: Playback, key: jax.Array) -> tuple["TaskEnv", dict[str, jax.Array]]:
        """The environment that begins at a moment of a clip, and entries of `info`."""
        row = playback.start(jax.random.fold_in(key, _OF_THE_REFERENCE))
        there = copy.copy(self)
        qpos, there.initial_qvel = playback.state(row)
        there.initial_qpos = qpos + self._lift
        if (activations := playback.activations(row)) is not None:
            there.initial_act = activations
        return there, {FRAME: row, FIRST_FRAME: row}

    def _with_reference(self, step: Step, info: Mapping[str, jax.Array]) -> Step:
        """The step, with the reference after it."""
        if self._playback is None:
            return step
        return replace(step, following=self._playback.following(info[FRAME], info[FIRST_FRAME]))

    def _on_terrain(
        self, key: jax.Array, model: ModelFields
    ) -> tuple["TaskEnv", ModelFields, dict[str, jax.Array]]:
        """The environment that begins where its ground is, the fields of the model, and entries of `info`."""
        if self._grid is None:
            return self, model, {}
        fields, lift, entries = self._grid.begun(jax.random.fold_in(key, _OF_THE_TERRAIN))
        there = copy.copy(self)
        there.initial_qpos = self.initial_qpos.at[self._parts.root_position + 2].add(lift)
        return there, {**fields, **model}, entries

    def _grounded(self, step: Step, info: Mapping[str, jax.Array]) -> Step:
        return step if self._grid is None else replace(step, ground=self._grid.ground(info))

    @property
    def inventory(self) -> Inventory:
        """The model's parts."""
        return self._inventory

    def places_of(self, terms: Sequence[ObservationTerm]) -> np.ndarray:
        has = list(placed_terms(observed(self._options), parts_of(self._options, self._inventory)))
        found = [next((places for one, places in has if one == term), ()) for term in terms]
        return np.array([place for places in found for place in places], int)

    def simulation(self) -> Simulation:
        if self._playback is not None:
            raise NotSimulated("it follows a reference, which the page does not have")
        command = self._options.command
        if command is not None and not isinstance(command, VelocityCommand):
            raise NotSimulated(f"its command is of the kind {command.kind}, and the page tells velocities")
        ranges = () if command is None else command.ranges
        if self._grid is None:
            return simulation_of(self, self._spec, ranges)
        there = copy.copy(self)
        there._grid = self._grid.given(jnp.zeros(self._grid.ground_size))
        simulation = simulation_of(there, self._spec, ranges, self._grid.ground_size)
        terrain = self._grid.simulated(simulation.model, self._parts.root_position + 2)
        return replace(simulation, terrain=terrain)

    def deployment(self) -> Deployment:
        """The task as a robot runs it. Raises NotDeployed."""
        if self._playback is not None:
            raise NotDeployed("it follows a reference, and a robot has no clips")
        parts = parts_of(self._options, self._inventory)
        return deployment(self._options, self._parts, parts, self.action_to_control.actuation)

    def told(self, command: jax.Array | None, ground: jax.Array | None = None) -> Self:
        there = copy.copy(self)
        if self._grid is not None and ground is not None:
            there._grid = self._grid.given(ground)
        there._chance, there._events = self._chance.left_out(), Events([], self._parts)
        there._command = self._command and self._command.given(command)
        return there

    def _after(self, step: Step, info: Mapping[str, jax.Array]) -> State:
        if (gait := self._options.gait) is not None:
            step = replace(step, phases=gait.phases(info["phase"], step))
        done = self._terms.ended(step)
        # The policy sees the command of the next step.
        told = replace(step, command=info.get("command"))
        obs, remembered = self._terms.seen(told, info, self._chance)
        if self._playback is not None:
            is_over = self._playback.is_over(info[FRAME])
            remembered = {**remembered, TRUNCATED: is_over * (1.0 - done)}
            done = jnp.maximum(done, is_over)
        return self.stepped(
            step.after,
            obs,
            rewards=self._terms.rewards(step),
            done=done,
            metrics=self._terms.metrics(step) | ({} if self._grid is None else self._grid.metrics(info)),
            info={**info, **remembered},
        )


def _indexed(options: TaskOptions, parts: Inventory, model: mujoco.MjModel) -> ModelIndex:
    """The model's parts as the terms name them; how many numbers a command follows from is not known yet."""
    root = model.body(options.root).id if options.root else root_of(model)
    start, named = first_positions(model, options.reset), parts_of(options, parts)
    feet = feet_of(model, options.feet, start)
    index = ModelIndex(model, root, start, feet, len(named.command), len(named.acting))
    if options.reference is None:
        return index
    followed = Followed.of(options.reference, model, root)
    return replace(index, followed_parts=followed, frames_ahead=options.reference.ahead.frames)
