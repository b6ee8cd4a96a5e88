"""The routers, one file for each resource; add a new one here."""

from api.routes import (
    catalog,
    events,
    files,
    health,
    jobs,
    logs,
    metrics,
    models,
    page,
    previews,
    problems,
    replay,
    sharing,
    sweeps,
)

ROUTERS = (
    jobs.router,
    events.router,
    metrics.router,
    logs.router,
    files.router,
    replay.router,
    sharing.router,
    sweeps.router,
    models.router,
    previews.router,  # Before the catalog's, whose ids may have slashes.
    catalog.router,
    health.router,
    problems.router,
    page.router,
)
