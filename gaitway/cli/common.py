"""The commands' common parts: the client, job names, JSON, and failures.

An expected failure is one line on stderr, with an exit code; anything else keeps its traceback.
0: it worked. 1: the job or the call failed. 2: the request was wrong. 130: interrupted.
"""

import json
import sys
from collections.abc import Callable, Iterable
from typing import Annotated, Any, cast

import typer
from pydantic import BaseModel, ByteSize
from rich.text import Text
from typer.core import TyperGroup

from gaitway.addresses import ID_LENGTH, SEARCHED, the_one
from gaitway.cli.terminal import Console, escaped, plain_output
from gaitway.client import Client
from gaitway.errors import GaitwayError, Rejected, Unauthenticated
from gaitway.schema import JobView, SweepView

# For commands whose arguments are for the programs that they start.
PASS_ON = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": list[str]()}
JobName = Annotated[
    str, typer.Argument(metavar="JOB", help="A job's id, an unambiguous beginning or end of it, or `last`.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]
Project = Annotated[
    str | None, typer.Option(help="Needless with one project of your own; without accounts, default.")
]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")]


class CommandGroup(TyperGroup):
    """A group of commands whose expected failures are sentences."""

    def invoke(self, ctx: Any) -> Any:
        try:
            with plain_output():
                return super().invoke(ctx)
        except GaitwayError as error:
            complain(str(error))
            if isinstance(error, Unauthenticated) and "gaitway login" not in str(error):
                complain("`gaitway login` stores another token.")
            raise typer.Exit(2 if isinstance(error, Rejected) else 1) from None
        except BrokenPipeError:
            raise typer.Exit(1) from None


def complain(sentence: str) -> None:
    """Print one message on stderr, without markup."""
    Console(stderr=True).print(Text(f"gaitway: {sentence}"), soft_wrap=True)


def wrong_usage(sentence: str) -> typer.Exit:
    """Print what is wrong with the command line; the caller raises the result."""
    complain(sentence)
    return typer.Exit(2)


def confirm(question: str, *, yes: bool) -> None:
    """Ask on a terminal. Raises typer.Exit where the answer is no, and where nobody is there to ask."""
    if yes:
        return
    if not sys.stdin.isatty():
        raise wrong_usage(f"{question} Nobody is here to ask: say so by --yes.")
    if not typer.confirm(question):
        raise typer.Exit(1)


def client_of(context: typer.Context) -> Client:
    """The client for the service that `--url` or GAITWAY_URL names."""
    client = Client(context.find_object(str))
    context.call_on_close(client.close)
    return client


def project_of(client: Client, project: str | None) -> str:
    """The named one, or one's only one. Raises typer.Exit(2)."""
    if project is not None:
        return project
    own = client.whoami().projects
    if len(own) > 1:
        raise wrong_usage(f"You are in several projects: say which by --project, one of {', '.join(own)}.")
    return own[0] if own else "default"


def job_id(client: Client, name: str) -> str:
    """The full id. Raises typer.Exit(2) where the abbreviation fits several jobs or none."""
    return full_id(name, lambda limit: client.list(limit=limit), "job")


def model_id(client: Client, name: str) -> str:
    """The id of the model of this name, the last sent of several. Raises typer.Exit(2) if there is none."""
    if name.startswith("sha256:"):
        return name
    found = list(client.models(name=name, limit=2))
    if not found:
        raise wrong_usage(f"No model is called {name!r}; `gaitway models list` shows names and ids.")
    if len(found) > 1:
        complain(f"Several models are called {name!r}; this is the last one that was sent, {found[0].id}.")
    return found[0].id


def clips_id(client: Client, name: str) -> str:
    """The id of the file of clips of this name, the last sent of several. Raises typer.Exit(2) if there is
    none."""
    if name.startswith("sha256:"):
        return name
    found = list(client.clip_files(name=name, limit=2))
    if not found:
        raise wrong_usage(f"No clips are called {name!r}; `gaitway clips list` shows names and ids.")
    if len(found) > 1:
        complain(
            f"Several files of clips are called {name!r}; this is the last that was sent, {found[0].id}."
        )
    return found[0].id


def names_to_ids(client: Client, options: Any) -> None:
    """Put ids in the place of the names of a model and of files of clips, among an environment's options."""
    if not isinstance(options, dict):
        return
    chosen = cast("dict[str, Any]", options)
    if isinstance(name := chosen.get("model"), str):
        chosen["model"] = model_id(client, name)
    reference = chosen.get("reference")
    clips = cast("dict[str, Any]", reference).get("clips") if isinstance(reference, dict) else None
    for one in cast("list[Any]", clips) if isinstance(clips, list) else ():
        if isinstance(one, dict) and isinstance(name := cast("dict[str, Any]", one).get("file"), str):
            one["file"] = clips_id(client, name)


def full_id(name: str, newest: Callable[[int], Iterable[JobView | SweepView]], what: str) -> str:
    """As `job_id`, of a job or a sweep. newest: how many, the newest first."""
    if len(name) == ID_LENGTH:
        return name
    ids = [one.id for one in newest(1 if name == "last" else SEARCHED)]
    try:
        return the_one(name, ids, what)
    except LookupError as error:
        raise wrong_usage(str(error)) from None


def label_of(text: str) -> tuple[str, str]:
    """A label of the form KEY=VALUE. Raises typer.Exit(2)."""
    name, sign, value = text.partition("=")
    if not sign:
        raise wrong_usage(f"--label {text!r} is not of the form KEY=VALUE.")
    return name, value


def print_json(document: Any) -> None:
    """A document on stdout, as plain text."""
    sys.stdout.write(escaped(json.dumps(_plain(document), indent=2, ensure_ascii=False)) + "\n")


def end_code(job: JobView) -> int:
    """0 for a job that succeeded, 1 for one that did not."""
    return 0 if job.succeeded else 1


def _plain(document: Any) -> Any:
    if isinstance(document, BaseModel):
        return document.model_dump(mode="json")
    if isinstance(document, list | tuple):
        return [_plain(item) for item in document]  # pyright: ignore[reportUnknownVariableType]
    return document


def size(number: int) -> str:
    """A number of bytes for people, such as 41.2 GB."""
    return ByteSize(number).human_readable(decimal=True, separator=" ")
