"""The bucket's layout, in one place.

jobs/<id>/spec.json                            the submission, before it is answered
jobs/<id>/record.json                          the job as it was after its newest transition that mattered
jobs/<id>/attempts/<n>/manifest.json           what readers may see of an attempt, written after its files
jobs/<id>/attempts/<n>/<name>                  its files
models/<hash>/source                           a user's own model, as it was sent
models/<hash>/record.json                      what a worker found in it
previews/<whose>/<hash>/<when>/about.json      the stills that were drawn, written last; or why not
previews/<whose>/<hash>/<when>/still-<n>.png   the stills; all of it may be lost
caches/<machine>/<environment>/<when>/<name>   what machines of a kind compiled for it; all of it may be lost
"""

from datetime import datetime

# Sorts before the stills: what is deleted in the order of names is not seen by half.
PREVIEW_RECORD = "about.json"


def job(job_id: str) -> str:
    return f"jobs/{job_id}/"


def spec(job_id: str) -> str:
    return f"jobs/{job_id}/spec.json"


def record(job_id: str) -> str:
    return f"jobs/{job_id}/record.json"


def manifest(job_id: str, attempt: int) -> str:
    return f"jobs/{job_id}/attempts/{attempt}/manifest.json"


def artifact(job_id: str, attempt: int, name: str) -> str:
    return f"jobs/{job_id}/attempts/{attempt}/{name}"


def models() -> str:
    return "models/"


def model(model_id: str) -> str:
    """model_id: `sha256:` and the hash."""
    return f"models/{model_id.removeprefix('sha256:')}/"


def model_source(model_id: str) -> str:
    return f"{model(model_id)}source"


def model_record(model_id: str) -> str:
    return f"{model(model_id)}record.json"


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
    """Of a folder that `preview_of` named; sorts by time."""
    return folder.removesuffix("/").rpartition("/")[2]


def caches() -> str:
    return "caches/"


def cache_of(machine: str, environment: str) -> str:
    return f"caches/{machine}/{environment}/"


def cached(machine: str, environment: str, when: str, name: str) -> str:
    return f"caches/{machine}/{environment}/{when}/{name}"
