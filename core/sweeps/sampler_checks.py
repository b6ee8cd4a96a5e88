"""Checks that a sweep's sampler can search its axes and follow its objectives."""

from collections.abc import Iterator

from core.errors import Problem
from core.sweeps.axes import has_one_value
from core.sweeps.fields import axis_place
from core.sweeps.spec import Range, SweepSpec


def problems_of_sampler(spec: SweepSpec) -> Iterator[Problem]:
    """Problems of a sweep by `cma_es`; the other samplers take every axis and any number of objectives."""
    if spec.method != "cma_es":
        return
    if len(spec.objectives) > 1:
        yield Problem("/objective", "`cma_es` follows one objective; give one, or take `tpe` or `nsga2`.")
    lists = [name for name, axis in spec.parameters.items() if not isinstance(axis, Range)]
    for name in lists:
        detail = f"`cma_es` takes ranges alone, and `{name}` is a list; give a range, or take `tpe`."
        yield Problem(axis_place(name), detail)
    varied = [
        axis for axis in spec.parameters.values() if isinstance(axis, Range) and not has_one_value(axis)
    ]
    if not lists and len(varied) < 2:
        detail = "`cma_es` learns how axes depend on each other; give two ranges, or take `tpe`."
        yield Problem("/parameters", detail)
