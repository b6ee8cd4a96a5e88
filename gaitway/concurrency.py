"""The differences between the two clients: `AsyncClient` awaits, `Client` waits in its thread.

`.ci/make_client.py` makes `gaitway.client` from `gaitway.async_client`; it drops `async_` from these names.
"""

import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Protocol, TypeVar

import anyio
import anyio.to_thread

from gaitway.errors import GaitwayError
from gaitway.notebook import Card
from gaitway.schema import JobView

Result = TypeVar("Result")

_PIECE_BYTES = 2**20

sleep = time.sleep
async_sleep = anyio.sleep


def run(function: Callable[[], Result]) -> Result:
    """Call a function that takes time."""
    return function()


async def async_run(function: Callable[[], Result]) -> Result:
    return await anyio.to_thread.run_sync(function)


def pieces(path: Path) -> Iterator[bytes]:
    """The file in pieces."""
    with path.open("rb") as file:
        while piece := file.read(_PIECE_BYTES):
            yield piece


async def async_pieces(path: Path) -> AsyncIterator[bytes]:
    async with await anyio.open_file(path, "rb") as file:
        while piece := await file.read(_PIECE_BYTES):
            yield piece


class _HasCards(Protocol):
    def card(self, job: JobView) -> Card: ...


def card_in_a_cell(client: _HasCards, job: JobView) -> Card:
    """The pictures of the job, fetched now; or why they could not be fetched."""
    try:
        return client.card(job)
    except (GaitwayError, RuntimeError) as error:  # RuntimeError: the client has been closed
        return Card(problem=str(error))


def async_card_in_a_cell(_client: object, _job: JobView) -> Card:
    """No pictures: a notebook does not await what describes a value."""
    return Card()
