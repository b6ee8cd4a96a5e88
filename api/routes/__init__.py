"""The routers, one file for each resource; add a new one here."""

from api.routes import (
    accounts,
    bulk,
    catalog,
    files,
    health,
    jobs,
    joining,
    metrics,
    models,
    monitoring,
    page,
    previews,
    replay,
    session,
    sharing,
    streams,
    sweeps,
    webhooks,
)

ROUTERS = (
    jobs.router,
    bulk.router,
    streams.router,
    metrics.router,
    files.router,
    replay.router,
    sharing.router,
    sweeps.router,
    models.router,
    previews.router,  # Before the catalog's, whose ids may have slashes.
    catalog.router,
    accounts.router,
    webhooks.router,
    joining.router,
    session.router,
    health.router,
    monitoring.router,
    page.router,
)
