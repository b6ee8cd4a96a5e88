"""What must hold of what users were told, and of what is stored. Each broken promise is a sentence."""

import hashlib
import re
import time
from collections.abc import Collection, Iterator, Sequence
from typing import Any

import httpx

from tests.faults.campaign.clients import Told, Users
from tests.faults.campaign.training import CHECKPOINT_EVERY, TOTAL, checkpoint, state_after
from tests.faults.campaign.world import World

_FINAL = ("succeeded", "failed", "cancelled")
# An idle worker clears up every half minute, and RQ believes for 70 s that a killed one has its message.
_SETTLING_S = 100.0
_DAMAGED = ("/problems/object-damaged", "/problems/object-not-found")
_DAMAGED_WITHIN_S = 15.0
_GAP = re.compile(r"Entr\w+ (\d+)(?: to)? ?(\d+)? of this feed")


def check(world: World, users: Users) -> list[str]:
    """Everything that is wrong; nothing, if all promises were kept."""
    found = [problem for told in users.told for problem in _of_job(world, told)]
    found += world.broken
    world.hurt.clear()
    world.broken.clear()
    found += _settled(world)
    return found + list(_secrets(world))


def _of_job(world: World, told: Told) -> Iterator[str]:
    name = f"job {told.job_id or '(never accepted)'} seed {told.seed}"
    yield from (f"{name}: {problem}" for problem in told.problems)
    if not told.job_id:
        yield f"{name}: no submission was ever answered"
        return
    with httpx.Client(base_url=world.url, timeout=20, trust_env=False) as http:
        answer = http.get(f"/jobs/{told.job_id}")
        if answer.status_code != 200:
            yield f"{name}: an accepted job is answered with {answer.status_code}"
            return
        job = answer.json()
        hurt = {key for key in world.hurt if f"/{told.job_id}/" in key}
        problems = (*_of_statuses(told, job), *_of_feeds(told, job, hurt), *_of_work(http, told, job, hurt))
        for problem in (*problems, *_of_files(http, told, job, hurt, world)):
            yield f"{name}: {problem}"


def _of_statuses(told: Told, job: dict[str, Any]) -> Iterator[str]:
    seen = [*told.statuses, job["status"]]
    if job["status"] not in _FINAL:
        yield f"it has not ended: {job['status']}"
    first_final = next((status for status in seen if status in _FINAL), None)
    if first_final is not None and seen[-1] != first_final:
        yield f"a final status changed: {seen}"
    if job["status"] == "failed":
        yield f"it failed: {job['reason']}: {job['message']}"
    if told.cancel_answered and job["status"] not in ("cancelled", "succeeded"):
        yield f"its cancel was answered, and it is {job['status']}"
    if job["status"] == "cancelled" and not told.cancel_answered:
        yield "nobody was told that it was cancelled, and it is"


def _of_feeds(told: Told, job: dict[str, Any], hurt: Collection[str]) -> Iterator[str]:
    is_hurt = _has_part(hurt, "events")
    if len(told.feeds) != 2:
        yield f"{len(told.feeds)} readers"
    for feed in told.feeds:
        numbers = [number for number, _, _ in feed]
        if numbers != list(range(1, len(numbers) + 1)) and not (is_hurt and _are_gaps_told(feed)):
            yield f"a reader saw a gap or a double: {numbers}"
        finals = [data["status"] for _, kind, data in feed if kind == "status" and data["status"] in _FINAL]
        if finals != [job["status"]] and not (is_hurt and not finals):
            yield f"a reader was told of the ends {finals}, and the job is {job['status']}"
    if len(told.feeds) == 2 and told.feeds[0] != told.feeds[1] and not is_hurt:
        yield "two readers saw different things"


def _has_part(hurt: Collection[str], channel: str) -> bool:
    return any(f"/{channel}/" in key for key in hurt)


def _are_gaps_told(feed: Sequence[tuple[int, str, Any]]) -> bool:
    """Whether the entries are in order, and a note stands in the place of all that are missing."""
    last = 0
    for number, kind, data in feed:
        if number <= last:
            return False
        if number > last + 1:
            found = _GAP.search(str(data.get("text", ""))) if kind == "note" else None
            if found is None or int(found[1]) > last + 1 or int(found[2] or found[1]) != number:
                return False
        last = number
    return True


def _of_work(http: httpx.Client, told: Told, job: dict[str, Any], hurt: Collection[str]) -> Iterator[str]:
    steps = [row["step"] for row in http.get(f"/jobs/{told.job_id}/metrics").json()["rows"]]
    is_whole = not _has_part(hurt, "events")
    if job["status"] == "succeeded" and is_whole and sorted(steps) != list(range(1, TOTAL + 1)):
        yield f"its metrics have the steps {steps}"
    if len(steps) != len(set(steps)):
        yield f"its metrics have a step twice: {steps}"
    # The training's own lines: those of two attempts' supervisors may be equal.
    log = http.get(f"/jobs/{told.job_id}/logs").text.splitlines()
    lines = [line for line in log if line.startswith("attempt ")]
    if len(lines) != len(set(lines)):
        yield f"its log has a line twice: {log}"
    has_gap = _has_part(hurt, "logs") and any("of this feed" in line for line in log)
    if not set(steps) <= {int(line.split()[-1]) for line in lines} and not has_gap:
        yield "its log lacks lines of steps that were measured"


def _of_files(
    http: httpx.Client, told: Told, job: dict[str, Any], hurt: Collection[str], world: World
) -> Iterator[str]:
    with world.database() as database:
        rows = database.execute("SELECT name, key FROM artifacts WHERE job_id = %s", (told.job_id,))
        damaged = {name for name, key in rows if key in hurt}
    for artifact in job["artifacts"]:
        began = time.monotonic()
        body = http.get(artifact["href"])
        took_s = time.monotonic() - began
        if artifact["name"] in damaged and body.status_code == 404:
            if (kind := body.json()["type"]) not in _DAMAGED or took_s > _DAMAGED_WITHIN_S:
                yield f"{artifact['name']}, which was damaged, is answered after {took_s:.0f} s with {kind}"
        elif body.status_code != 200 or hashlib.sha256(body.content).hexdigest() != artifact["sha256"]:
            yield f"{artifact['name']} is answered with {body.status_code} and other bytes than its hash says"
        elif artifact["role"] == "checkpoint" and body.content != checkpoint(told.seed, artifact["step"]):
            yield f"{artifact['name']} is not that of an undisturbed run"
        elif artifact["role"] == "policy" and body.text != state_after(told.seed, artifact["step"]):
            yield "the policy is not that of an undisturbed run"
    if job["status"] == "succeeded":
        # A worker that is about to go leaves the event file for TensorBoard out.
        roles = sorted(a["role"] for a in job["artifacts"] if a["role"] != "tensorboard")
        if roles != ["checkpoint", "checkpoint", "metrics", "policy"]:
            yield f"a finished job has {roles}"
        last = max(a["step"] for a in job["artifacts"] if a["role"] == "checkpoint")
        if last != TOTAL or TOTAL % CHECKPOINT_EVERY:
            yield f"its last checkpoint is of step {last}"


def _settled(world: World) -> list[str]:
    """The processes, spools, locks and messages in Redis that are left after a while."""
    deadline = time.monotonic() + _SETTLING_S
    while (left := [*world.left_over(), *_in_redis(world)]) and time.monotonic() < deadline:
        time.sleep(0.1)
    return [f"left behind: {item}" for item in left]


def _in_redis(world: World) -> list[str]:
    with world.redis() as client:
        # RQ forgets by itself what it thinks has failed.
        return [key.decode() for key in client.scan_iter("rq:job:*") if client.ttl(key) < 0]


def _secrets(world: World) -> Iterator[str]:
    for party in ("api", "reconciler", "worker-1", "worker-2"):
        if world.weed.secret_key in world.logs(party):
            yield f"the log of {party} holds the object store's secret key"
        for process in world.processes(party):
            if world.weed.secret_key in " ".join(process.cmdline()):
                yield f"a command line of {party} holds the object store's secret key"
