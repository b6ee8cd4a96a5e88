"""`gaitway preview`: shows an environment before anything is trained."""

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from gaitway.cli.common import AsJson, client_of, name_to_model, print_json
from gaitway.cli.errors import wrong_usage
from gaitway.cli.submit import Show, assigned, option


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
    given: dict[str, Any] = {}
    for text in options or ():
        assigned(given, option(text))
    client = client_of(context)
    name_to_model(client, given)
    pictures = client.preview(
        environment,
        output,
        options=given,
        camera=camera,
        show=show or (),
        size=(int(pixels[1]), int(pixels[2])),
    )
    if as_json:
        print_json({str(seen): str(file) for seen, file in pictures.items()})
        return
    for file in pictures.values():
        print(file)
