"""The largest accepted requests beside trainings, each of which has one attempt and must not lose it.

Imports have a tenth of their largest size here, so that hundreds of episodes fit on the disks of a world.
Models and previews are left out: those cost a worker its time, and wait for one.

`python -m tests.faults.campaign.episode --kinds largest --seeds 100 [--first 0]`
"""

import random
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Any
from urllib.parse import quote

import httpx

from tests.faults.campaign.faults import Campaign, Fault
from tests.faults.campaign.largest_requests import Service, forms, largest_job, routes
from tests.faults.campaign.world import World

_SHARE = 0.1
_TIMEOUT_S = 60.0
_ROUTES = 3


class _Place:
    """A service, and what it has got for the forms of earlier episodes."""

    def __init__(self, world: World) -> None:
        http = httpx.Client(base_url=world.url, timeout=_TIMEOUT_S, trust_env=False)
        self.service = Service(http, Path(mkdtemp(dir=world.folder)), _SHARE)
        self.document: dict[str, Any] = http.get("/openapi.json").json()
        self.routes = [one for one in routes(self.document) if "model" not in one and "preview" not in one]

    def send(self, rng: random.Random) -> list[str]:
        """The faults of the answers."""
        found = list[str]()
        for route in rng.sample(self.routes, _ROUTES):
            try:
                for form in forms(self.service, self.document, route):
                    # A loaded machine's database may take too long, which is told as an outage.
                    replace(form, accepted=(*form.accepted, 503)).send(self.service.http)
            except (AssertionError, httpx.HTTPError) as error:
                found.append(f"{route}: {type(error).__name__} {error}")
        return found

    def tidy(self) -> None:
        """End what waits for workers that no world has."""
        service = self.service
        for sweep in service.insist("GET", "/sweeps?limit=200").json()["items"]:
            if sweep["status"] in ("running", "cancelling"):
                service.cancel_sweep(sweep["id"])
        path = f"/jobs?status=queued&name={quote(largest_job()['name'])}"
        while waiting := service.insist("GET", path).json()["items"]:
            for job in waiting:
                service.insist("POST", f"/jobs/{job['id']}/cancel")


_places: dict[str, _Place] = {}


def _place(world: World) -> _Place:
    if world.url not in _places:
        _places[world.url] = _Place(world)
    return _places[world.url]


def _largest(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    own = random.Random(rng.random())

    return Fault(
        f"largest forms of {_ROUTES} routes",
        at_s,
        lasts_s,
        lambda world: world.broken.extend(_place(world).send(own)),
        lambda world: _place(world).tidy(),
    )


CAMPAIGN = Campaign({"largest": (_largest, 1)}, spec={"max_attempts": 1}, settings={"GAITWAY_LEASE": "12"})
