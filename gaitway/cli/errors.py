"""Expected failures as one line on stderr, with an exit code; anything else keeps its traceback.

0: it worked. 1: the job or the call failed. 2: the request was wrong. 130: interrupted.
"""

from typing import Any

import typer
from rich.text import Text
from typer.core import TyperGroup

from gaitway.cli.terminal import Console, plain_output
from gaitway.errors import GaitwayError, Rejected


class Group(TyperGroup):
    """A group of commands whose expected failures are sentences."""

    def invoke(self, ctx: Any) -> Any:
        try:
            with plain_output():
                return super().invoke(ctx)
        except GaitwayError as error:
            complain(str(error))
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
