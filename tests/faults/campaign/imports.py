"""Imports that somebody has made to do harm, beside trainings, while the API may be killed or cut off.

Each is refused with a sentence, or is a job like another: all its parts can be read, and it can be deleted.

`python -m tests.faults.campaign.episode --kinds imports --seeds 100 [--first 0]`
"""

import random
import signal
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import httpx
from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.faults.campaign.faults import Campaign, Fault, misbehaving
from tests.faults.campaign.hostile_imports import PARTS, archives
from tests.faults.campaign.largest_import import Import
from tests.faults.campaign.proxy import Mode
from tests.faults.campaign.world import World

# Of each fault. The first that Hypothesis makes is always the simplest.
_IMPORTS = 5
_TIMEOUT_S = 20.0
_SPEC = {"kind": "train", "environment": {"id": "ant"}, "seed": 1}


@cache
def _export() -> bytes:
    with TemporaryDirectory() as folder:
        return (
            Import(files=3, attempts=2, rows=3, names=3).write(Path(folder, "export.zip"), _SPEC).read_bytes()
        )


def _hostile(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    number = rng.randrange(2**32)

    def send(world: World) -> None:
        @seed(number)
        @settings(
            max_examples=_IMPORTS,
            database=None,
            deadline=None,
            phases=[Phase.generate],
            suppress_health_check=[
                HealthCheck.too_slow,
                HealthCheck.data_too_large,
                HealthCheck.large_base_example,
            ],
        )
        @given(archive=archives(_export()))
        def bring(archive: bytes) -> None:
            with httpx.Client(base_url=world.url, timeout=_TIMEOUT_S, trust_env=False) as http:
                world.broken.extend(f"hostile import {number}: {one}" for one in _broken(http, archive))

        bring()

    return Fault(f"{_IMPORTS} hostile imports", at_s, 0.0, send)


def _broken(http: httpx.Client, archive: bytes) -> list[str]:
    """The faults of the answers; an outage may be the answer to any."""
    answer = _asked(
        http, "POST", "/jobs/import", content=archive, headers={"Content-Type": "application/zip"}
    )
    if answer is None:
        return []
    if answer.status_code == 422:
        return [] if answer.json()["detail"].endswith((".", "?")) else [answer.text[:300]]
    if answer.status_code != 201:
        return [f"POST /jobs/import: {answer.status_code} {answer.text[:300]}"]
    path = f"/jobs/{answer.json()['id']}"
    wanted = [("GET", f"{path}{part}", 200) for part in PARTS] + [("DELETE", path, 204)]
    answers = [(_asked(http, method, part), part, status) for method, part, status in wanted]
    return [
        f"{part}: {found.status_code} {found.text[:300]}"
        for found, part, status in answers
        if found is not None and found.status_code != status
    ]


def _asked(http: httpx.Client, method: str, path: str, **sent: object) -> httpx.Response | None:
    """None for an outage."""
    try:
        answer = http.request(method, path, **sent)  # type: ignore[arg-type]
    except httpx.HTTPError:
        return None
    return None if answer.status_code == 503 else answer


def _api_killed(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    return Fault("SIGKILL api", at_s, 0.0, lambda world: world.signal("api", signal.SIGKILL, which=0))


def _cut_off(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    """The API from a store."""
    store = rng.choice(("postgres", "weed"))
    return misbehaving(
        "api", store, rng.choice((Mode.REFUSE, Mode.LOSE_ANSWERS, Mode.TRUNCATE)), at_s, lasts_s
    )


CAMPAIGN = Campaign({"hostile": (_hostile, 6), "api_killed": (_api_killed, 1), "cut_off": (_cut_off, 1)})
