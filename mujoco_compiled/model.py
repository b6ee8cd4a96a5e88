"""A model with code made for it: its control step without anything that another body would need."""

import copy
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from mujoco_compiled.code.function_source import FunctionSource
from mujoco_compiled.constraints.contact_room import MOST_NCONMAX
from mujoco_compiled.coverage import Uncovered, uncovered, uncovered_own
from mujoco_compiled.fields import MODEL_FIELDS, model_field
from mujoco_compiled.smooth.delays import control_places
from mujoco_compiled.write import Plan, control_step_in_lanes, control_step_program, derived_program

Move = Literal["forward", "step"]
_Call = Callable[..., tuple[jax.Array, ...]]
_CARRIED = ("qpos", "qvel", "act", "qacc_warmstart")
# Derived fields that may depend on activations and controls.
_OF_FORCES = {"qfrc_actuator", "sensordata"}


class Moves:
    """The code that moves one model, made while JAX traces and compiles.

    model: its numbers must not change any more. nstep: how many substeps a step has. derived: the fields of
    the state that are computed. nconmax: see `put_model`.
    """

    def __init__(
        self, model: mujoco.MjModel, nstep: int, derived: Sequence[str], nconmax: int | None
    ) -> None:
        self.model, self.nstep, self.derived, self._nconmax = model, nstep, tuple(derived), nconmax
        self._described = f"{_fingerprint(model)} {nstep} {self.derived} {nconmax}"
        blank = mujoco.MjData(model)
        # What a step reads and changes.
        self.carried = (*_CARRIED, *(("history",) if control_places(model) else ()))
        names = (*self.carried, "time", "ctrl", *derived)
        self.shapes = {name: np.shape(getattr(blank, name)) for name in names}
        self._calls: dict[tuple[Move, tuple[str, ...]], tuple[FunctionSource, _Call]] = {}
        self._own = set[tuple[str, ...]]()
        self._call("step", ())

    def check_own(self, names: Sequence[str]) -> None:
        """Raises Uncovered, or ValueError for an unknown field, if environments cannot have these fields of
        the model for themselves."""
        if (key := tuple(sorted(names))) in self._own:
            return
        if unknown := sorted(set(key) - set(MODEL_FIELDS)):
            raise ValueError(f"Environments cannot differ in {unknown}, only in {MODEL_FIELDS}.")
        if reason := uncovered_own(self.model, key, self.derived):
            raise Uncovered(reason)
        self._own.add(key)

    def moved(
        self, move: Move, state: Mapping[str, jax.Array], own: Mapping[str, jax.Array]
    ) -> dict[str, jax.Array]:
        """The fields of one environment after the move, in MuJoCo's shapes.

        state: those that are carried, time and ctrl. own: its own fields of the model.
        """
        source, call = self._call(move, tuple(name for name, values in sorted(own.items()) if values.size))
        fields = {**state, **own}
        values = call(*(jnp.ravel(jnp.asarray(fields[name], jnp.float32)) for name in source.inputs))
        found = dict(zip(source.outputs, values, strict=True))
        wanted = (*(self.carried if move == "step" else ()), *self.derived)
        return {
            name: found[name].reshape(self.shapes[name]) if name in found else jnp.zeros(self.shapes[name])
            for name in wanted
        }

    def _call(self, move: Move, own: tuple[str, ...]) -> tuple[FunctionSource, _Call]:
        """The move, for environments that differ in these fields of the model."""
        if (move, own) not in self._calls:
            source = self._source(move, own)
            self._calls[move, own] = source, _on_this_device(source)
        return self._calls[move, own]

    def _source(self, move: Move, own: tuple[str, ...]) -> FunctionSource:
        needs_all = move == "step" or not _OF_FORCES.isdisjoint(self.derived)
        read = (*self.carried, "ctrl") if needs_all else ("qpos", "qvel")
        reads_time = "sensordata" in self.derived
        own_sizes = {name: np.size(model_field(self.model, name)) for name in own}
        inputs = self._sizes((*read, "time") if reads_time else read) | own_sizes
        written = self._sizes((*(self.carried if move == "step" else ()), *self.derived))
        plan = Plan(self.model, inputs, own, self.derived, self._nconmax)
        described = f"{move} {self._described} {own}"
        if move == "forward":
            write, alone = partial(derived_program, plan), partial(derived_program, plan, alone=True)
            return FunctionSource(described, write, alone, inputs, written, is_rare=True)
        write, in_lanes = (
            partial(one, plan, self.nstep) for one in (control_step_program, control_step_in_lanes)
        )
        return FunctionSource(described, write, in_lanes, inputs, written)

    def _sizes(self, names: tuple[str, ...]) -> dict[str, int]:
        """Fields without elements are neither read nor written."""
        return {name: size for name in names if (size := int(np.prod(self.shapes[name])))}


@partial(jax.tree_util.register_dataclass, data_fields=["own"], meta_fields=["moves"])
@dataclass(frozen=True, eq=False)
class Model:
    """What `put_model` returns. Its leaves are the fields of the model that environments have for themselves,
    by MuJoCo's names and in its shapes; `jax.vmap` maps over them, or not (`in_axes=(None, 0)`)."""

    moves: Moves
    own: Mapping[str, jax.Array] = field(default_factory=dict[str, jax.Array])

    def tree_replace(self, fields: Mapping[str, jax.Array]) -> "Model":
        """The model with these of `MODEL_FIELDS`, such as `body_mass` or `opt.gravity`; each set of names has
        code of its own. Raises Uncovered if environments cannot have them for themselves."""
        own = {**self.own, **fields}
        self.moves.check_own(tuple(own))
        return Model(self.moves, own)


def put_model(
    model: mujoco.MjModel, *, nstep: int = 1, derived: Sequence[str] = (), nconmax: int | None = None
) -> Model:
    """The model for `step` and `forward`; its code is made in the background, for a GPU while JAX traces, or
    read where `keep_code` has kept it. Raises Uncovered if the model has what the stages cannot compute, or
    begins with more contacts than there is room for; ValueError for an `nconmax` beyond 1 to 1,024.

    nstep: how many time steps of the model a `step` has, under constant controls. derived: which of
    `DERIVED_FIELDS` are computed with each `step`; what is not asked for costs nothing. The solver is
    Newton's, with the model's iterations and tolerance; everything is float32.

    nconmax: the contacts of an environment at once for which there is room, of each kind (those of two bodies
    that move, and those with what stands still, by number of directions). None: twice as many as the model
    has in a short simulation, up to 512. On a CPU, where environments share it, it is 512 or more.
    """
    if nconmax is not None and not 1 <= nconmax <= MOST_NCONMAX:
        raise ValueError(f"nconmax is {nconmax:,}; it must be from 1 to {MOST_NCONMAX:,}.")
    if reason := uncovered(model, derived, nconmax):
        raise Uncovered(reason)
    return Model(Moves(copy.copy(model), nstep, derived, nconmax))


def _on_this_device(source: FunctionSource) -> _Call:
    """The function for the processor that JAX uses."""
    if jax.default_backend() == "cpu":
        from mujoco_compiled.code.cpu_call import CpuCall

        return CpuCall(source)
    from mujoco_compiled.code.gpu_call import GpuCall

    return GpuCall(source)


def _fingerprint(model: mujoco.MjModel) -> str:
    """Equal for equal models, in any process."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.data).hexdigest()
