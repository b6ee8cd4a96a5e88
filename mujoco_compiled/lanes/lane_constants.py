"""A model whose constants are symbols where limbs that are alike differ in them."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from mujoco_compiled.lanes.limbs import Limbs
from mujoco_compiled.program.program import Program, Symbol
from mujoco_compiled.smooth.delays import control_places
from mujoco_compiled.substep import Model

# The fields of parts of limbs begin with these.
_BY_PARTS = ("body", "dof", "geom", "jnt")


class NotAlike(Exception):
    """Why limbs cannot share a program, as a part of a sentence."""


def with_lane_constants(program: Program, model: Model, limbs: Limbs) -> Model:
    """The model. Raises NotAlike if limbs differ in more than numbers."""
    place = _Places(program, limbs)
    tree, constraints = model.tree, model.constraints
    return replace(
        model,
        tree=replace(
            tree,
            bodies=place.merged(tree.bodies, place.bodies()),
            dofs=place.merged(tree.dofs, list(limbs.alike("qvel"))),
        ),
        tendons=place.merged(model.tendons, place.grouped(model.tendons, lambda one: one.path.dofs)),
        actuators=place.merged(model.actuators, place.grouped(model.actuators, lambda one: one.path.dofs)),
        fluid=replace(model.fluid, drags=place.merged_drags(model.fluid.drags)),
        constraints=replace(
            constraints,
            **{
                name: place.merged(values, place.grouped(values, lambda one: one.path.dofs))
                for name, values in (("frictions", constraints.frictions), ("limits", constraints.limits))
            },
            ball_limits=place.merged(
                constraints.ball_limits, place.grouped(constraints.ball_limits, lambda one: [one.dof])
            ),
            ties=place.merged(
                constraints.ties,
                place.grouped(
                    constraints.ties, lambda one: [one.one.body, one.other.body], limbs.lane_of_body
                ),
            ),
            couplings=place.merged(
                constraints.couplings, place.grouped(constraints.couplings, lambda one: one.dofs)
            ),
            contacts=place.merged(
                constraints.contacts,
                place.grouped(
                    constraints.contacts, lambda one: [one.one.body, one.other.body], limbs.lane_of_body
                ),
            ),
        ),
    )


def alike_inputs(model: Model, limbs: Limbs, own: Sequence[str] = ()) -> dict[str, list[tuple[int, ...]]]:
    """Places of the state's, the controls' and some fields' numbers that are alike, by lane."""
    place = _Places(Program(), limbs)
    actuators = place.grouped(model.actuators, lambda one: one.path.dofs)
    late = control_places(limbs.model)
    activations = [[model.actuators[one].activation for one in alike] for alike in actuators]
    return {
        **{name: list(limbs.alike(name)) for name in ("qpos", "qvel", "qacc_warmstart")},
        **{name: list(limbs.alike(name)) for name in own if name.split("_")[0] in _BY_PARTS},
        "ctrl": actuators,
        "history": [
            places
            for alike in actuators
            if alike[0] in late
            for places in zip(*(late[one] for one in alike), strict=True)
        ],
        "act": [
            tuple(one.address for one in alike if one is not None)
            for alike in activations
            if None not in alike
        ],
    }


class _Places:
    def __init__(self, program: Program, limbs: Limbs) -> None:
        self._program, self._limbs = program, limbs

    def bodies(self) -> list[tuple[int, ...]]:
        return list(zip(*self._limbs.bodies, strict=True))

    def grouped(
        self,
        elements: Sequence[Any],
        numbers: Callable[[Any], Iterable[int]],
        lane_of: dict[int, int] | None = None,
    ) -> list[tuple[int, ...]]:
        """Places of elements that are alike, by lane, in their order; those of the trunk are left out.

        numbers: of an element's degrees of freedom, or bodies with `lane_of`.
        """
        lane_of = self._limbs.lane_of_dof if lane_of is None else lane_of
        lanes: list[list[tuple[list[int], int]]] = [[] for _ in range(self._limbs.num_lanes)]
        for place, element in enumerate(elements):
            own = [number for number in numbers(element) if number in lane_of]
            if len({lane_of[number] for number in own}) > 1:
                raise NotAlike(f"{type(element).__name__.lower()} {place} binds limbs to each other")
            if own:
                lane = lane_of[own[0]]
                # In the order of the limb, whatever the model's is.
                first = min(number for number, other in lane_of.items() if other == lane)
                lanes[lane].append((sorted(number - first for number in own), place))
        if len({len(own) for own in lanes}) > 1:
            raise NotAlike("a limb has parts that another has not")
        return list(zip(*([place for _, place in sorted(own)] for own in lanes), strict=True))

    def merged(self, elements: Sequence[Any], alike: Iterable[tuple[int, ...]]) -> tuple[Any, ...]:
        found = list(elements)
        for places in alike:
            for place, one in zip(places, self._values([elements[place] for place in places]), strict=True):
                found[place] = one
        return tuple(found)

    def merged_drags(self, drags: dict[int, Any]) -> dict[int, Any]:
        found = dict(drags)
        for bodies in self.bodies():
            present = [body for body in bodies if body in drags]
            if present and len(present) < len(bodies):
                raise NotAlike("the fluid drags some limbs only")
            found |= zip(present, self._values([drags[body] for body in present]), strict=True)
        return found

    def _values(self, values: list[Any]) -> list[Any]:
        """Values of the lanes, with symbols for numbers in which they differ."""
        if not values:
            return []
        first = values[0]
        if len({type(value) for value in values}) > 1:
            raise NotAlike("limbs have parts of different kinds")
        if isinstance(first, bool | int | str) or first is None:
            return values
        if isinstance(first, float):
            return self._numbers(values)
        if isinstance(first, Symbol):
            return values
        if is_dataclass(first):
            names = [field.name for field in fields(first)]
            columns = {name: self._values([getattr(value, name) for value in values]) for name in names}
            return [
                replace(value, **{name: columns[name][lane] for name in names})
                for lane, value in enumerate(values)
            ]
        return self._several(values)

    def _several(self, values: list[Any]) -> list[Any]:
        if len({len(value) for value in values}) > 1:
            raise NotAlike("a limb has parts that another has not")
        if isinstance(values[0], dict):
            columns = [self._values(list(own)) for own in zip(*(one.values() for one in values), strict=True)]
            keys: list[list[Hashable]] = [list(value) for value in values]
            return [
                dict(zip(keys[lane], (column[lane] for column in columns), strict=True))
                for lane in range(len(values))
            ]
        columns = [self._values(list(own)) for own in zip(*values, strict=True)]
        return [type(value)(column[lane] for column in columns) for lane, value in enumerate(values)]

    def _numbers(self, values: list[float]) -> list[Any]:
        # Rounding leaves differences, which would be operations at every substep.
        if np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
            return [min(values, key=abs)] * len(values)
        return [self._program.write("limb_constant", lane, *values) for lane in range(len(values))]
