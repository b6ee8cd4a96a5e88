"""The bucket's layout, in one place.

jobs/<id>/attempts/<n>/<hash>/<name>           an attempt's files, by the hash of their bytes
jobs/<id>/imported/<hash>/<name>               what came with an import, by the hash of its bytes: files, and
                                               parts of feeds
jobs/<id>/<channel>/<first>-<hash>.jsonl       a finished part of a feed, from entry <first> on
jobs/<id>/metrics/<first>-<hash>.msgpack       the same for metrics, in columns
models/<hash>/source                           a user's own model, as it was sent
clips/<hash>/source                            a file of clips, as it was sent
clips/<hash>/<name>                            what a worker made of it: its clips, a replay and its scene
previews/<whose>/<hash>/<when>/about.json      which stills were drawn, or why none; written last
previews/<whose>/<hash>/<when>/still-<n>.png   the stills; previews may be lost without harm
caches/<machine>/<environment>/<when>/<name>   programs compiled on this kind of machine; may be lost too
"""

from datetime import datetime

# Sorts before the stills: a deletion in the order of names removes it first, so nobody sees half a preview.
PREVIEW_RECORD = "about.json"


def folders() -> tuple[str, ...]:
    """The folders of everything that the service keeps."""
    return (jobs(), models(), clip_files(), previews(), caches())


def job(job_id: str) -> str:
    return f"jobs/{job_id}/"


def jobs() -> str:
    return "jobs/"


def job_of(key: str) -> str:
    """The id of the job that an object belongs to."""
    return key.split("/")[1]


def artifact(job_id: str, attempt: int, sha256: str, name: str) -> str:
    return f"jobs/{job_id}/attempts/{attempt}/{sha256[:16]}/{name}"


def imported(job_id: str, sha256: str, name: str) -> str:
    return f"jobs/{job_id}/imported/{sha256[:16]}/{name}"


def is_imported(key: str) -> bool:
    return key.split("/")[2:3] == ["imported"]


def chunk(job_id: str, channel: str, first: int, sha256: str, ending: str = "jsonl") -> str:
    return f"jobs/{job_id}/{channel}/{first:012d}-{sha256[:16]}.{ending}"


def models() -> str:
    return "models/"


def model(model_id: str) -> str:
    """model_id: `sha256:` and the hash."""
    return f"models/{model_id.removeprefix('sha256:')}/"


def model_source(model_id: str) -> str:
    return f"{model(model_id)}source"


def clip_files() -> str:
    return "clips/"


def clip_file(file_id: str) -> str:
    """file_id: `sha256:` and the hash."""
    return f"clips/{file_id.removeprefix('sha256:')}/"


def clip_file_source(file_id: str) -> str:
    return f"{clip_file(file_id)}source"


def made_of_clips(file_id: str, name: str) -> str:
    return f"{clip_file(file_id)}{name}"


def previews() -> str:
    return "previews/"


def previews_of(subject: str) -> str:
    """subject: an environment's id, or a model's."""
    return f"previews/{subject.removeprefix('sha256:')}/"


def preview(subject: str, preview_id: str) -> str:
    return f"{previews_of(subject)}{preview_id}/"


def preview_of(subject: str, preview_id: str, when: datetime) -> str:
    return f"{preview(subject, preview_id)}{when:%Y%m%dT%H%M%S.%fZ}/"


def when_drawn(folder: str) -> str:
    """The time in a folder's name from `preview_of`; sorts by time."""
    return folder.removesuffix("/").rpartition("/")[2]


def caches() -> str:
    return "caches/"


def cache_of(machine: str, environment: str) -> str:
    return f"caches/{machine}/{environment}/"


def cached(machine: str, environment: str, when: str, name: str) -> str:
    return f"caches/{machine}/{environment}/{when}/{name}"
