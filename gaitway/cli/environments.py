"""`gaitway environments` and `preview`: the environments that a job may name, and their looks."""

import re
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer

from gaitway.cli.common import AsJson, client_of, names_to_ids, print_json, wrong_usage
from gaitway.cli.submit import Show, assigned, option
from gaitway.client import Client
from gaitway.schema import EnvironmentDetails, SliceView

_MOST_NAMES = 4


def environments(
    context: typer.Context,
    environment: Annotated[
        str | None, typer.Argument(help="Only this one, with the numbers of its observation and action.")
    ] = None,
    options: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="OPTION=VALUE", help="An option of it, e.g. walker=rodent."),
    ] = None,
    family: Annotated[
        str | None,
        typer.Option(help="`gaitway`, or a package with environments: playground, brax."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the environments that a job may name, or show one; --family lists those of another package."""
    client = client_of(context)
    if environment is None and options:
        raise wrong_usage("--set is for one environment: name it (`gaitway environments corridor --set …`).")
    if environment is None:
        _list(client, family, as_json)
        return
    chosen: dict[str, Any] = {}
    for text in options or ():
        assigned(chosen, option(text))
    names_to_ids(client, chosen)
    found = client.environment(environment, chosen)
    if as_json:
        print_json(found)
    else:
        _show(found)


def _list(client: Client, family: str | None, as_json: bool) -> None:
    found = client.environments()
    shown = [one for one in found if one.family == (family or "gaitway")]
    if as_json:
        print_json(shown)
        return
    for one in shown:
        print(f"{one.id:<36}  {one.description}")
    if family is None:
        others = Counter(one.family for one in found if one.family != "gaitway")
        for name, number in others.items():
            print(f"and {number} of {name}: --family {name}")
    elif not shown:
        print(f"There are no environments of {family}.")


def _show(found: EnvironmentDetails) -> None:
    print(f"{found.id}  {found.description}")
    print(f"\nobservation: {_count(found.observation)}")
    for one in found.observation:
        print(_row(one))
    print(f"\naction: {_count(found.action)} in [-1, 1]; the range is what these ends set")
    for one in found.action:
        print(_row(one))


def _count(slices: tuple[SliceView, ...]) -> str:
    return f"{sum(one.size for one in slices)} numbers"


def _row(one: SliceView) -> str:
    """Where the slice is, its unit and bounds, and the first of its names."""
    bounded = (one.low, one.high) != (None, None)
    bounds = f"{_bound(one.low, '-∞')} to {_bound(one.high, '∞')}" if bounded else ""
    names = [name for name in one.components[:_MOST_NAMES] if name != one.name]
    more = ", …" if len(one.components) > _MOST_NAMES else ""
    place = f"{one.start:>5}  {one.size:>4}"
    return f"{place}  {one.name}  {one.unit or ''}  {bounds}  {', '.join(names)}{more}".rstrip()


def _bound(value: float | None, none: str) -> str:
    return none if value is None else f"{value:g}"


def preview(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    environment: Annotated[str, typer.Argument(help="The environment, e.g. ant.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="A folder; by default the current one.")
    ] = None,
    options: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="OPTION=VALUE", help="An option of the environment, e.g. walker=rodent."
        ),
    ] = None,
    camera: Annotated[str | None, typer.Option(help="Only this camera; by default all.")] = None,
    show: Show = None,
    size: Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="In pixels.")] = "640x480",
    as_json: AsJson = False,
) -> None:
    """Render an environment as an episode begins: a PNG from `track` and from each of the model's cameras."""
    pixels = re.fullmatch(r"(\d{1,4})x(\d{1,4})", size)
    if pixels is None:
        raise wrong_usage(f"--size {size}: write it as 640x480.")
    chosen: dict[str, Any] = {}
    for text in options or ():
        assigned(chosen, option(text))
    client = client_of(context)
    names_to_ids(client, chosen)
    pictures = client.preview(
        environment,
        output,
        options=chosen,
        camera=camera,
        show=show or (),
        size=(int(pixels[1]), int(pixels[2])),
    )
    if as_json:
        print_json({str(seen): str(file) for seen, file in pictures.items()})
        return
    for file in pictures.values():
        print(file)
