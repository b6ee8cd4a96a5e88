"""`gaitway models add`, `list`, `show`, `delete`: users' own models."""

import sys
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer
from rich.text import Text

from gaitway.cli.common import AsJson, CommandGroup, client_of, model_id, print_json
from gaitway.cli.terminal import Console
from gaitway.schema import ModelView, WorkerView

models = typer.Typer(cls=CommandGroup, help="Bring models of your own, for jobs in the environment `mjcf`.")
ModelName = Annotated[
    str, typer.Argument(metavar="MODEL", help="Its name or its `sha256:…`, as `add` and `list` print them.")
]


@models.command()
def add(
    context: typer.Context,
    file: Annotated[
        Path, typer.Argument(exists=True, dir_okay=False, help="MJCF, URDF, or a zip of it and its meshes.")
    ],
    name: Annotated[
        str | None, typer.Option(help="What to call it, up to 100 characters; by default as the file.")
    ] = None,
    main: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Of a zip with several documents: the one that is the model."),
    ] = None,
    project: Annotated[
        str | None, typer.Option(help="Whose members may use it; needless with one project of your own.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Send a model, and show what is in it once it is validated."""
    client = client_of(context)
    if wait := what_it_waits_for(list(client.workers())):
        Console(stderr=True).print(Text(wait), soft_wrap=True)
    _told(client.add_model(file, name=name, main=main, project=project), as_json)


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
        print(f"{model.id}  {model.status}  {model.size:,} bytes  {model.name or ''}".rstrip())
    if not found:
        print("No models.")


@models.command()
def show(
    context: typer.Context,
    model: ModelName,
    recipe: Annotated[
        bool,
        typer.Option("--recipe", help="Print a job instead, in which the robot learns to walk by command."),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show what is in a model."""
    client = client_of(context)
    found = client.model(model_id(client, model))
    if recipe:
        _recipe(found)
    else:
        _told(found, as_json)


@models.command()
def delete(context: typer.Context, model: ModelName) -> None:
    """Delete a model that no unfinished job needs."""
    client = client_of(context)
    client.delete_model(found := model_id(client, model))
    print(f"Model {found} is deleted.")


def what_it_waits_for(workers: Sequence[WorkerView], what: str = "the model") -> str | None:
    """A sentence if no worker can read what was sent soon; None if one is free."""
    if not workers:
        return f"No worker runs; {what} waits until one does."
    if any(not worker.job and not worker.jobs for worker in workers):
        return None
    first = workers[0]
    job = first.job or first.jobs[0]
    who = "The only worker is" if len(workers) == 1 else f"All {len(workers)} workers are"
    return (
        f"{who} busy ({first.name} with job {job}): a worker reads {what} after its job, "
        "before those that wait."
    )


def _told(model: ModelView, as_json: bool) -> None:
    if as_json:
        print_json(model)
        return
    print(f"{model.id}  {model.status}  {model.name or ''}".rstrip())
    if model.message:
        print(f"  {model.message}")
    if model.description:
        for line in _lines(model.description):
            print(f"  {line}")
    if model.recipe_job is not None:
        print(
            f"A job in which it learns to walk: gaitway models show {quote(model.name or model.id)} --recipe"
        )


def _recipe(model: ModelView) -> None:
    """Print the job, and on the standard error what was guessed in it. Exits with 1 where there is none."""
    for note in (model.description or {}).get("recipe_notes", []):
        print(note, file=sys.stderr)
    if (job := model.recipe_job) is None:
        print("There is no recipe for this model.", file=sys.stderr)
        raise typer.Exit(1)
    print_json(job)


# Those that a worker tries; `mjx` comes last, and takes up to minutes.
_ENGINES = ("native", "compiled", "warp", "mjx")


def _how(tried: str | None, seconds: float | None) -> str:
    """How an engine moved it, and how long its code took to make."""
    made = "" if seconds is None else f" (made and tried in {seconds:g} s)"
    return f"; {tried}{made}" if tried else made


def _actuator(found: dict[str, Any]) -> str:
    within = found["control_range"]
    name = found["name"] or "without a name"
    return f"{name} [{within[0]:g}, {within[1]:g}]" if within else f"{name} (no range)"


def _sensor(found: dict[str, Any]) -> str:
    beyond = ", ".join(found.get("beyond", {}))
    said = f"{found['name'] or 'without a name'} ({found['type']}"
    return f"{said}; not on {beyond})" if beyond else f"{said})"


def _lines(found: dict[str, Any]) -> list[str]:
    """First what its owner can judge, then what its engines say, then its parts."""
    has, sizes = found["inventory"], found["inventory"]["sizes"]
    return [
        *([f"read from {found['main']}"] if found.get("main") else []),
        *_of_the_recipe(found.get("recipe") or {}),
        f"{has['mass_kg']:.3g} kg, root {has['root']!r}",
        f"begins at {has['initial_height']:.3g} m, without actions settles at "
        f"{found['settled_height']:.3g} m",
        *found["notes"],
        *_engines(found),
        f"nq {sizes['nq']}, nv {sizes['nv']}, nu {sizes['nu']}",
        f"bodies: {', '.join(has['bodies'])}",
        f"joints: {', '.join(joint['name'] or 'a ' + joint['type'] for joint in has['joints'])}",
        f"actuators: {', '.join(map(_actuator, has['actuators']))}",
        f"sensors: {', '.join(map(_sensor, has['sensors'])) or 'none'}",
        f"cameras: {', '.join(filter(None, has['cameras'])) or 'none'}",
        f"keyframes: {', '.join(filter(None, has['keyframes'])) or 'none'}",
        f"{found['physics_steps_per_second']:,.0f} physics steps/s of C MuJoCo on one core",
    ]


def _of_the_recipe(options: dict[str, Any]) -> list[str]:
    """How it stands in the job in which it learns to walk."""
    edits = options.get("edits")
    if not edits:
        return []
    pose = edits.get("pose", {})
    stands = "joints as the recipe says" if pose.get("joints") else "as it is in its file"
    if keyframe := pose.get("keyframe"):
        stands = f"the keyframe {keyframe!r}"
    return [f"feet: {', '.join(edits.get('feet', []))}", f"pose: {stands}"]


def _engines(found: dict[str, Any]) -> list[str]:
    """Which run it with the recipe's edits, then which do as it is, and what was tried."""
    tried, seconds = found.get("trials", {}), found.get("code_seconds", {})
    able = [name for name, why in found.get("recipe_engines", {}).items() if why is None]
    lines = [f"engines with the recipe's edits: {', '.join(able)}"] if able else []
    for name, why in found["engines"].items():
        told = f"does not run it: {why}" if why else f"runs it{_how(tried.get(name), seconds.get(name))}"
        lines.append(f"{name}, as it is: {told}")
    lines += [f"{name}, as it is: {words}" for name, words in tried.items() if name not in found["engines"]]
    if taken := found.get("auto"):
        chosen = ", ".join(f"{name} on a {kind.upper()}" for kind, name in taken.items())
        lines.append(f"`auto` takes {chosen}, as it is")
    left = [name for name in _ENGINES if name not in tried and not found["engines"].get(name)]
    if left and not found["complete"]:
        lines.append(f"still being tried: {', '.join(left)}; `gaitway models show` tells it later")
    return lines
