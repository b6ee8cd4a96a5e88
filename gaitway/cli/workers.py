"""`gaitway workers`: who trains."""

import typer
from rich.table import Table
from rich.text import Text

from gaitway.cli.common import AsJson, client_of, print_json
from gaitway.cli.terminal import Console


def workers(context: typer.Context, as_json: AsJson = False) -> None:
    """List the workers that have sent a heartbeat lately, with what they do."""
    found = list(client_of(context).workers())
    if as_json:
        print_json(found)
        return
    if not found:
        print("No worker is running.")
        return
    table = Table(box=None, pad_edge=False)
    for column in ("WORKER", "DEVICE", "STATE", "JOBS"):
        table.add_column(column, overflow="fold")
    for worker in found:
        state = f"{worker.state}: {worker.problem}" if worker.problem else worker.state
        jobs = worker.jobs or ((worker.job,) if worker.job else ())
        table.add_row(*map(Text, (worker.name, worker.device, state, ", ".join(jobs) or "none")))
    Console().print(table)
