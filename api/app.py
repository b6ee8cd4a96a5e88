"""The HTTP edge. Composition root: only `build` knows the real adapters."""

from importlib.metadata import version

from fastapi import FastAPI

from api import problems
from api.correlation import Correlation
from api.dependencies import Service
from api.openapi import describe, serve
from api.origins import OriginCheck
from api.routes import ROUTERS
from core.configuration import read
from core.jobs.queue import JobQueue
from core.settings import ApiSettings
from core.storage.objects import ObjectStore
from core.sweeps.sweep import SweepStore

_DESCRIPTION = """Train simulated bodies to walk: submit a training or a rollout, follow it, fetch its video.

Every refusal is `application/problem+json` (RFC 9457). Times are RFC 3339 in UTC; ids sort by time."""


def create_app(
    settings: ApiSettings,
    *,
    store: SweepStore,
    queue: JobQueue,
    objects: ObjectStore,
    patient: ObjectStore | None = None,
) -> FastAPI:
    """The service, built from these parts. patient: the object store for requests that may take minutes."""
    app = interface()
    app.state.service = Service(settings, store, queue, objects, patient)
    app.add_middleware(Correlation, origin_check=OriginCheck(settings.hosts))
    return app


def interface() -> FastAPI:
    """Every route and its description; `create_app` adds what answers."""
    app = FastAPI(
        title="Gaitway",
        version=version("gaitway"),
        description=_DESCRIPTION,
        redirect_slashes=False,
        docs_url=None,  # `api.routes.page` serves it, without any network but this service.
        redoc_url=None,
        openapi_url=None,  # `serve` answers it
    )
    app.openapi = lambda: describe(app)
    serve(app)
    problems.install(app)
    for router in ROUTERS:
        app.include_router(router)
    return app


def build(settings: ApiSettings) -> FastAPI:
    """The service over PostgreSQL, RQ and the object store that the settings name."""
    from core.adapters.wiring import job_queue, job_store, object_store

    # A client waits for each answer, so a store that does not answer is given up after two seconds.
    objects = object_store(settings, retries=1, timeout_s=2.0)
    return create_app(
        settings,
        store=job_store(settings),
        queue=job_queue(settings),
        objects=objects,
        patient=object_store(settings),
    )


def from_environment() -> FastAPI:
    """The service, configured from the environment; for `uvicorn --factory api.app:from_environment`.

    Raises Misconfigured.
    """
    from core.adapters.startup import check_stores

    settings = read(ApiSettings)
    check_stores(settings, timeout_s=0)  # until they answer, requests get 503
    return build(settings)
