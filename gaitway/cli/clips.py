"""`gaitway clips add`, `list`, `show`, `rename`, `delete`: recordings of motion, which jobs imitate."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from gaitway.cli.common import AsJson, CommandGroup, client_of, clips_id, model_id, print_json
from gaitway.cli.models import what_it_waits_for
from gaitway.cli.terminal import Console
from gaitway.client import Client
from gaitway.schema import ClipFileView

clips = typer.Typer(cls=CommandGroup, help="Bring clips of motion, which a body is to follow.")
ClipsName = Annotated[
    str, typer.Argument(metavar="CLIPS", help="Its name or its `sha256:…`, as `add` and `list` print them.")
]


@clips.command()
def add(  # noqa: PLR0913 # The command's options.
    context: typer.Context,
    file: Annotated[
        Path,
        typer.Argument(exists=True, dir_okay=False, help="NPZ, HDF5, CSV and others; see docs/imitation.md."),
    ],
    body: Annotated[
        str, typer.Option(help="Whose clips they are: an environment such as `g1`, or a model of your own.")
    ],
    rate: Annotated[
        float | None, typer.Option(min=0.0, help="Frames per second, for a file that does not say.")
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            exists=True, dir_okay=False, help="JSON: which points of the body the key points of the file are."
        ),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="What to call it, up to 100 characters; by default as the file.")
    ] = None,
    project: Annotated[
        str | None, typer.Option(help="Whose members may use it; needless with one project of your own.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Send a file of clips, and show what is in it once it is validated."""
    client = client_of(context)
    if wait := what_it_waits_for(list(client.workers()), "the file of clips"):
        Console(stderr=True).print(Text(wait), soft_wrap=True)
    whose = _body(client, body)
    _told(client.add_clips(file, whose, rate=rate, points=points, name=name, project=project), as_json)


@clips.command("list")
def list_all(
    context: typer.Context,
    limit: Annotated[int | None, typer.Option("--limit", "-n", min=1, help="By default, all.")] = None,
    as_json: AsJson = False,
) -> None:
    """List files of clips, the last sent first."""
    found = list(client_of(context).clip_files(limit=limit))
    if as_json:
        print_json(found)
        return
    for file in found:
        so_far = file.message if file.status == "validating" and file.message else _sum(file)
        print(f"{file.id}  {file.status}  {file.body[:20]}  {so_far}  {file.name or ''}".rstrip())
    if not found:
        print("No clips.")


@clips.command()
def show(context: typer.Context, file: ClipsName, as_json: AsJson = False) -> None:
    """Show what is in a file of clips."""
    client = client_of(context)
    _told(client.clip_file(clips_id(client, file)), as_json)


@clips.command()
def rename(
    context: typer.Context, file: ClipsName, name: Annotated[str, typer.Argument(help="The new name.")]
) -> None:
    """Give a file of clips another name."""
    client = client_of(context)
    print(f"Clips {client.rename_clips(clips_id(client, file), name).id} are called {name!r}.")


@clips.command()
def delete(context: typer.Context, file: ClipsName) -> None:
    """Delete a file of clips that no unfinished job needs."""
    client = client_of(context)
    client.delete_clips(found := clips_id(client, file))
    print(f"Clips {found} are deleted.")


def _body(client: Client, body: str) -> str:
    """The body's id: a model of one's own may be given by its name."""
    if body.startswith("sha256:") or any(one.id == body for one in client.environments()):
        return body
    return model_id(client, body)


def _told(file: ClipFileView, as_json: bool) -> None:
    if as_json:
        print_json(file)
        return
    print(f"{file.id}  {file.status}  {file.body[:20]}  {file.name or ''}".rstrip())
    if file.message:
        print(f"  {file.message}")
    if (found := file.description) is None:
        return
    print(f"  {found.format}, {_sum(file)}")
    for clip in found.clips:
        print(f"  {clip.name}: {clip.num_frames:,} frames at {clip.rate:g}/s, {clip.seconds:.2f} s")
        for warning in clip.warnings:
            print(f"    {warning}")
    for point in found.key_points:
        mean, worst = ((value or 0) * 1000 for value in (point.mean_distance, point.worst_distance))
        off = f"{mean:.1f} mm off, at worst {worst:.1f} mm" if point.num_seen else "never seen"
        print(f"  {point.name} at {point.body}: {off}")
    print(f"  joints: {', '.join(found.joints)}")


def _sum(file: ClipFileView) -> str:
    clips = [] if file.description is None else file.description.clips
    return f"{len(clips)} clip{'' if len(clips) == 1 else 's'}, {sum(clip.seconds for clip in clips):.1f} s"
