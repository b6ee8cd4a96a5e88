"""Run on a compute node in a worker's place, by its batch script: whether a worker could work there.

It prints a sentence for each thing that is wrong, or `ready on NODE (DEVICE)`.
"""

import platform
import sys

from core.adapters.startup import exercise_objects, exercise_queue
from core.adapters.wiring import connect_redis, job_store, object_store
from core.configuration import read
from core.errors import GaitwayError, Misconfigured
from core.settings import WorkerSettings
from worker.host.device import device_of
from worker.host.disk import check_folder

READY = "ready on"


def wrong_here() -> list[str]:
    """A sentence for each thing that is wrong."""
    try:
        settings = read(WorkerSettings)
        device_of(settings.device)
        check_folder(settings.data_dir)
    except Misconfigured as error:
        return [error.detail]
    found = list[str]()
    for use in (
        lambda: job_store(settings, pool_size=0).ping(),
        lambda: exercise_queue(connect_redis(settings.redis_url.get_secret_value(), retries=0)),
        lambda: exercise_objects(object_store(settings, retries=0)),
    ):
        try:
            use()
        except GaitwayError as error:
            found.append(error.detail)
    return found


def main() -> None:
    """Exits with 1 if something is wrong."""
    found = wrong_here()
    sys.stdout.write(" ".join(found) or f"{READY} {platform.node()}")
    sys.stdout.write("\n")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
