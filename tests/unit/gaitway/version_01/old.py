"""What version 0.1 itself wrote (data.json), on the test's servers, and how to look at what became of it."""

import base64
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from core.adapters.postgres.jobs import PostgresJobStore
from core.adapters.s3.objects import S3ObjectStore
from core.jobs import feeds
from core.jobs.job import Job
from core.jobs.store import Channel, Entry, JobQuery
from core.settings import StoreSettings, WorkerSettings
from core.variables import variable
from gaitway.service.import_01 import import_stores

OLD: dict[str, Any] = json.loads((Path(__file__).parent / "data.json").read_text())
IDS: dict[str, str] = OLD["jobs"]
MODELS: dict[str, str] = OLD["models"]
LEASE = timedelta(seconds=15)


def load_redis(client: Any) -> None:
    """Everything that version 0.1 had there."""
    for key, found in OLD["redis"].items():
        value = found["value"]
        match found["type"]:
            case "hash":
                client.hset(key, mapping=value)
            case "stream":
                for at, said in value:
                    client.xadd(key, said, id=at)
            case "zset":
                client.zadd(key, dict.fromkeys(value, 0))
            case _:
                client.set(key, value)
        if found["expires_ms"] > 0:
            client.pexpire(key, found["expires_ms"])


def load_objects(store: S3ObjectStore) -> None:
    for key, body in OLD["objects"].items():
        store.put(key, base64.b64decode(body))


class Old:
    """Version 0.1's data on the test's servers, and what may have become of them."""

    def __init__(self, settings: WorkerSettings, client: Any, objects: S3ObjectStore) -> None:
        self.settings, self.redis, self.objects = settings, client, objects
        load_redis(client)
        load_objects(objects)

    def import_all(self, *, without_redis: bool = False) -> tuple[bool, list[str]]:
        """Whether all could be read, and what was said."""
        said: list[str] = []
        return import_stores(self.settings, said.append, without_redis=without_redis), said

    def live(self, name: str) -> dict[str, Any]:
        """The document in Redis."""
        return json.loads(self.redis.hget(f"gaitway:job:{IDS[name]}", "document"))

    def write_live(self, name: str, document: dict[str, Any] | str, **fields: Any) -> None:
        text = document if isinstance(document, str) else json.dumps(document)
        self.redis.hset(f"gaitway:job:{IDS[name]}", mapping={"document": text, **fields})

    def copy(self, name: str) -> dict[str, Any]:
        """The document in the object store."""
        return json.loads(self.objects.get(f"jobs/{IDS[name]}/record.json"))

    def write_copy(self, name: str, document: dict[str, Any] | str) -> None:
        text = document if isinstance(document, str) else json.dumps(document)
        self.objects.put(f"jobs/{IDS[name]}/record.json", text.encode())


def listed(store: PostgresJobStore) -> dict[str, Job]:
    """Every job in the record, by the name that the fixture gave it."""
    names = {job_id: name for name, job_id in IDS.items()}
    found = store.list(JobQuery(), limit=1000).jobs
    assert all(isinstance(job, Job) for job in found)
    return {names[job.id]: job for job in found if isinstance(job, Job)}


def feed(old: Old, store: PostgresJobStore, name: str, channel: Channel = "events") -> Sequence[Entry]:
    return feeds.read(IDS[name], channel, store=store, objects=old.objects, limit=100_000)


def streamed(name: str, channel: Channel = "events") -> list[tuple[str, datetime, dict[str, Any]]]:
    """What version 0.1 had in the feed."""
    found = OLD["redis"][f"gaitway:job:{IDS[name]}:{channel}"]["value"]
    entries = [Entry.model_validate_json(said["entry"]) for _, said in found]
    return [(entry.kind, entry.time, entry.data) for entry in entries]


def told(entries: Sequence[Entry]) -> list[tuple[str, datetime, dict[str, Any]]]:
    return [(entry.kind, entry.time, entry.data) for entry in entries]


def environment_of(settings: StoreSettings) -> dict[str, str]:
    """The settings as variables."""
    said = {name: getattr(settings, name) for name in StoreSettings.model_fields}
    plain = {
        name: value.get_secret_value() if hasattr(value, "get_secret_value") else str(value)
        for name, value in said.items()
        if value is not None
    }
    return {variable(name): value for name, value in plain.items()}


def command(*arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    code = "from gaitway.cli.main import app; app()"
    base = {name: value for name, value in os.environ.items() if not name.startswith("GAITWAY_")}
    return subprocess.run(
        [sys.executable, "-c", code, "import-0.1", *arguments],
        env={**base, **environment},
        capture_output=True,
        text=True,
    )
