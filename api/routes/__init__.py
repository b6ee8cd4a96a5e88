"""Every resource, one file each; to add one, name it here."""

from api.routes import catalog, events, files, health, index, jobs, logs, metrics, problems

ROUTERS = (
    jobs.router,
    events.router,
    metrics.router,
    logs.router,
    files.router,
    catalog.router,
    health.router,
    problems.router,
    index.router,
)
