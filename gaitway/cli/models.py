"""`gaitway models add`, `list`, `show`, `delete`: users' own models."""

from pathlib import Path
from typing import Annotated, Any

import typer

from gaitway.cli.common import AsJson, client_of, print_json
from gaitway.cli.errors import Group
from gaitway.views import ModelView

models = typer.Typer(cls=Group, help="Bring models of your own, for jobs in the environment `mjcf`.")
ModelId = Annotated[str, typer.Argument(metavar="MODEL", help="`sha256:…`, as `add` and `list` print it.")]


@models.command()
def add(
    context: typer.Context,
    file: Annotated[
        Path, typer.Argument(exists=True, dir_okay=False, help="MJCF, URDF, or a zip of it and its meshes.")
    ],
    as_json: AsJson = False,
) -> None:
    """Send a model, and show what is in it once it is validated."""
    _told(client_of(context).add_model(file), as_json)


@models.command("list")
def list_all(
    context: typer.Context,
    limit: Annotated[int | None, typer.Option("--limit", "-n", min=1, help="By default, all.")] = None,
    as_json: AsJson = False,
) -> None:
    """List models, the last sent first."""
    found = list(client_of(context).models(limit=limit))
    if as_json:
        print_json(found)
        return
    for model in found:
        print(f"{model.id}  {model.status}  {model.size:,} bytes")
    if not found:
        print("No models.")


@models.command()
def show(context: typer.Context, model: ModelId, as_json: AsJson = False) -> None:
    """Show what is in a model."""
    _told(client_of(context).model(model), as_json)


@models.command()
def delete(context: typer.Context, model: ModelId) -> None:
    """Delete a model that no unfinished job needs."""
    client_of(context).delete_model(model)
    print(f"Model {model} is deleted.")


def _told(model: ModelView, as_json: bool) -> None:
    if as_json:
        print_json(model)
        return
    print(f"{model.id}  {model.status}")
    if model.message:
        print(f"  {model.message}")
    if model.description:
        for line in _lines(model.description):
            print(f"  {line}")


def _lines(found: dict[str, Any]) -> list[str]:
    has, sizes = found["inventory"], found["inventory"]["sizes"]
    lines = [
        f"nq {sizes['nq']}, nv {sizes['nv']}, nu {sizes['nu']}",
        f"{has['mass_kg']:.3g} kg, root {has['root']!r}",
        f"bodies: {', '.join(has['bodies'])}",
        f"joints: {', '.join(joint['name'] or 'a ' + joint['type'] for joint in has['joints'])}",
        f"cameras: {', '.join(filter(None, has['cameras'])) or 'none'}",
        f"keyframes: {', '.join(filter(None, has['keyframes'])) or 'none'}",
        f"{found['physics_steps_per_second']:,.0f} physics steps/s on one core",
    ]
    lines += [f"{name}: {why or 'runs it'}" for name, why in found["engines"].items()]
    if not found["complete"]:
        lines.append("the other engines are still being tried: run `gaitway models show` in a moment")
    return [*lines, *found["notes"]]
