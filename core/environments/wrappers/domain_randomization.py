"""Domain randomisation: an environment that draws fields of the model at every fresh start, or also later.

Source: Peng et al., Sim-to-Real Transfer of Robotic Control with Dynamics Randomization (2018);
Brax's `randomization_fn` and MuJoCo Playground's `domain_randomize`, which draw once for a run.
"""

import copy
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from core.environments.environment import Environment, State, Wrapped
from core.environments.model_rows import object_names, rows_of
from core.environments.randomization import FIELDS, FieldName, Randomization
from core.errors import JobFailed
from core.patterns import matching
from core.physics.engine import CONSTANTS, NOMINAL, ModelFields
from core.reasons import Reason
from mujoco_compiled import model_field

# Enough for neighbouring environments to differ; MuJoCo's constants are derived for each model.
NUM_MODELS = 1024
# Entries of `State.info`, where fields change within an episode: of its random numbers, and the steps so far.
_KEY, _STEPS = "randomization_key", "randomization_steps"
_OF_THE_EPISODE = 7  # Folded into the key that chose the start's model.
_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RandomizedEnvironment(Wrapped):
    """An environment in which every fresh start takes one of the models of a pool.

    pool: fields of the model [NUM_MODELS, ...], the same for every seed; the key of a start picks one.
    intervals: of fields that become those of another model within an episode, after so many steps each. Those
    that change in a step come from one model.
    """

    pool: Mapping[str, NDArray[np.float32]]
    intervals: Mapping[str, int] = field(default_factory=dict[str, int])

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        reset_key, model_key = jax.random.split(key)
        state = self.environment.reset(reset_key, {**self._drawn(model_key), **model})
        if not self.intervals:
            return state
        of_the_episode = jax.random.key_data(jax.random.fold_in(model_key, _OF_THE_EPISODE))
        return _remembering(state, of_the_episode, jnp.zeros((), jnp.int32))

    def step(self, state: State, action: jax.Array) -> State:
        if not self.intervals:
            return self.environment.step(state, action)
        info = dict(state.info)
        key, steps = info.pop(_KEY), info.pop(_STEPS)
        own = state.physics.model
        fresh = self._drawn(jax.random.fold_in(jax.random.wrap_key_data(key), steps))
        changed = {
            name: jnp.where((steps > 0) & (steps % interval == 0), fresh[name], own[name])
            for name, interval in self.intervals.items()
        }
        physics = replace(state.physics, model={**own, **changed})
        after = self.environment.step(replace(state, physics=physics, info=info), action)
        return _remembering(after, key, steps + 1)

    def _drawn(self, key: jax.Array) -> ModelFields:
        """The fields of one of the models."""
        chosen = jax.random.randint(key, (), 0, NUM_MODELS)
        return {name: jnp.asarray(values)[chosen] for name, values in self.pool.items()}


def _remembering(state: State, key: jax.Array, steps: jax.Array) -> State:
    return replace(state, info={**state.info, _KEY: key, _STEPS: steps})


def randomize(environment: Environment, rules: Sequence[Randomization]) -> Environment:
    """The environment, randomised by these rules; unchanged if there are none.

    Raises JobFailed("bad_model") if the model lacks what a rule names, or if a rule gives an impossible
    value, such as a negative friction.
    """
    if not rules:
        return environment
    pool = draw_models(environment.model, rules)
    intervals: dict[str, int] = {
        rule.field: max(1, round(rule.every_s / environment.dt))
        for rule in rules
        if rule.every_s is not None and rule.field in pool
    }
    return RandomizedEnvironment(environment, pool, intervals)


def draw_models(model: mujoco.MjModel, rules: Sequence[Randomization]) -> dict[str, NDArray[np.float32]]:
    """The fields [NUM_MODELS, ...] that the rules change, and the constants that MuJoCo derives from them.

    Rules are applied one after the other, so two may change the same numbers. Raises like `randomize`.
    """
    names: list[FieldName] = [name for rule in rules for name in rule.fields]
    fields: dict[FieldName, _Floats] = {
        name: np.repeat(np.asarray(model_field(model, name), np.float64)[None], NUM_MODELS, axis=0)
        for name in names
    }
    for number, rule in enumerate(rules):
        before = fields[rule.field].copy()
        _apply(model, fields[rule.field], rule, seed=rule.draw or f"{number}")
        if rule.recompute_inertia:
            ratio = fields[rule.field] / np.where(before > 0, before, 1.0)
            fields["body_inertia"] *= np.where(before > 0, ratio, 1.0)[..., None]
    for name, values in fields.items():
        _check(model, name, values)
    derives = any(FIELDS[name].changes_constants for name in fields)
    changed = {**fields, **(_constants(model, fields) if derives else {})}
    return {name: values.astype(np.float32) for name, values in changed.items() if values.size}


def _apply(model: mujoco.MjModel, values: _Floats, rule: Randomization, seed: str) -> None:
    """Changes the field [NUM_MODELS, ...] in place."""
    rows, owners = _rows(model, rule)
    numbers = _numbers(rule, seed, owners.max(initial=0) + 1)[:, owners]  # [NUM_MODELS, rows]
    # A field without rows becomes a matrix of one row.
    matrix = values.reshape(NUM_MODELS, -1, FIELDS[rule.field].size)
    columns = slice(None) if rule.axis is None else slice(rule.axis, rule.axis + 1)
    before = matrix[:, rows, columns]
    match rule.operation:
        case "scale":
            matrix[:, rows, columns] = before * numbers[..., None]
        case "add":
            matrix[:, rows, columns] = before + numbers[..., None]
        case "set":
            matrix[:, rows, columns] = numbers[..., None]


def _numbers(rule: Randomization, seed: str, count: int) -> _Floats:
    """[NUM_MODELS, count or 1] numbers of the rule's range, spread evenly over it (Latin hypercube)."""
    random = np.random.default_rng(zlib.crc32(seed.encode()))
    wanted = count if rule.each else 1
    order = random.permuted(np.tile(np.arange(NUM_MODELS), (wanted, 1)), axis=1).T
    fraction = (order + random.random((NUM_MODELS, wanted))) / NUM_MODELS
    low, high = np.log(rule.range) if rule.distribution == "log_uniform" else rule.range
    numbers = low + fraction * (high - low)
    return np.exp(numbers) if rule.distribution == "log_uniform" else numbers


def _rows(model: mujoco.MjModel, rule: Randomization) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows of the field that the rule changes, and for each row the index of its random number.

    The index is that of the object the row belongs to, or always 0 if all objects share one number.
    """
    kind = FIELDS[rule.field].kind
    if kind is None:
        return np.zeros(1, np.intp), np.zeros(1, np.intp)
    known = object_names(model, kind)
    objects = range(len(known)) if rule.names is None else _found(kind, rule.names, known)
    rows = [row for one in objects for row in rows_of(model, rule.field, one)]
    owners = [number for number, one in enumerate(objects) for _ in rows_of(model, rule.field, one)]
    return np.array(rows, np.intp), np.array(owners, np.intp) * rule.each


def _found(kind: str, patterns: Sequence[str], known: Sequence[str]) -> Sequence[int]:
    """The numbers of the objects with these names, or whose names these patterns match, in turn."""
    chosen = dict[str, None]()
    for pattern in patterns:
        names = [pattern] if pattern in known else matching([pattern], known)
        if not names:
            named = ", ".join(filter(None, known)) or "none with a name"
            raise _bad(f"randomization: the model has no {kind} {pattern!r}; there are {named}.")
        chosen |= dict.fromkeys(names)
    return list(map(known.index, chosen))


def _check(model: mujoco.MjModel, name: FieldName, values: _Floats) -> None:
    if FIELDS[name].positive and values.min(initial=0.0) < 0:
        raise _bad(f"randomization: {name} becomes negative in some environments ({values.min():g}).")
    if (
        name in ("body_mass", "body_inertia")
        and (values[:, np.asarray(model_field(model, name)) > 0] <= 0).any()
    ):
        raise _bad(f"randomization: {name} becomes 0 in some environments; such a body could not be stepped.")
    if name == "body_ipos":
        for body in np.flatnonzero((values != model.body_ipos).any(axis=(0, 2)) & _is_simple(model)).tolist():
            raise _bad(
                f"randomization: the body {model.body(body).name!r} moves alone, with its centre of mass in "
                "its origin, so MuJoCo has no room for the inertia that another centre brings: move the "
                "centre in the model, too."
            )
    if name == "dof_frictionloss" and values[:, model.dof_frictionloss == 0].any():
        raise _bad(
            "randomization: some of these joints have no dof_frictionloss in the model, and engines make "
            "room only for joints that have it; name only those."
        )


def _constants(model: mujoco.MjModel, fields: Mapping[FieldName, _Floats]) -> dict[str, _Floats]:
    """`CONSTANTS` [NUM_MODELS, ...] as MuJoCo derives them for each of the models."""
    scratch, data = copy.copy(model), mujoco.MjData(model)
    rows: list[dict[str, _Floats]] = []
    for number in range(NUM_MODELS):
        for name, values in fields.items():
            model_field(scratch, name)[...] = values[number]
        mujoco.mj_setConst(scratch, data)
        rows.append({name: np.array(model_field(scratch, name)) for name in CONSTANTS})
    return {name: np.stack([row[name] for row in rows]) for name in CONSTANTS}


def _is_simple(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """[nbody]: those for whose matrix of inertia MuJoCo has room on its diagonal alone."""
    return (model.body_simple != 0) & (model.body_dofnum > 1)


def _bad(detail: str) -> JobFailed:
    return JobFailed(Reason.BAD_MODEL, detail)
