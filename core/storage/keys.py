"""The bucket's layout, in one place.

jobs/<id>/spec.json                            the submission, before it is answered
jobs/<id>/record.json                          the job as it was after its newest transition that mattered
jobs/<id>/attempts/<n>/manifest.json           what readers may see of an attempt, written after its files
jobs/<id>/attempts/<n>/<name>                  its files
models/<hash>/source                           a user's own model, as it was sent
models/<hash>/record.json                      what a worker found in it
caches/<machine>/<environment>/<when>/<name>   what machines of a kind compiled for it; all of it may be lost
"""


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


def caches() -> str:
    return "caches/"


def cache_of(machine: str, environment: str) -> str:
    return f"caches/{machine}/{environment}/"


def cached(machine: str, environment: str, when: str, name: str) -> str:
    return f"caches/{machine}/{environment}/{when}/{name}"
