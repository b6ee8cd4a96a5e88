"""`gaitway battery`: the test of a policy that follows velocity commands or clips."""

from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from gaitway.battery import ShownBattery, shown_battery
from gaitway.cli.common import AsJson, JobName, client_of, job_id, print_json, wrong_usage
from gaitway.cli.submit import follow
from gaitway.cli.terminal import Console


def battery(  # noqa: PLR0913 - A command line's options.
    context: typer.Context,
    job: JobName,
    run: Annotated[bool, typer.Option("--run", help="Test its policy now, by a rollout job.")] = False,
    starts: Annotated[int | None, typer.Option(help="With --run: episodes for each command or clip.")] = None,
    push: Annotated[
        float | None, typer.Option(metavar="M/S", help="With --run: shove it every 4 s, up to this speed.")
    ] = None,
    best: Annotated[bool, typer.Option("--best", help="With --run: the best evaluation's policy.")] = False,
    seed: Annotated[
        int | None, typer.Option("--seed", help="Whose, of a job with several seeds; by default the first's.")
    ] = None,
    watch: Annotated[bool, typer.Option("--watch", "-w", help="With --run: stay and show it.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show how a job's policy follows commands or clips in C MuJoCo, as its battery found, or --run one."""
    client = client_of(context)
    full_id = job_id(client, job)
    if run:
        asked: dict[str, Any] = {} if starts is None else {"starts": starts}
        if push is not None:
            asked["push"] = {"kind": "push", "every_s": 4.0, "speed": push}
        sent = client.test_policy(full_id, best=best, seed=seed, **asked)
        follow(client, sent, watch=watch, as_json=as_json)
    if best or watch or starts is not None or push is not None:
        raise wrong_usage("--starts, --push, --best and --watch say how a battery is made: add --run.")
    found = client.battery(full_id, seed=seed)
    if as_json:
        print_json(found)
        return
    shown = shown_battery(found)
    if shown is None:
        raise wrong_usage("The file battery.json of this job is of another version: see it by --json.")
    for part in (shown.verdict, *_tables(shown), shown.legend):
        Console().print(part)


def _tables(shown: ShownBattery) -> list[Table]:
    criteria, commands = Table(box=None, pad_edge=False), Table(box=None, pad_edge=False)
    for name in ("QUANTITY", "VALUE", "BOUND", "HOLDS"):
        criteria.add_column(name)
    for row in shown.criteria:
        criteria.add_row(*map(Text, row))
    for name in shown.head:
        commands.add_column(name.upper(), no_wrap=True)
    for row in shown.rows:
        commands.add_row(*map(Text, row))
    return [criteria, commands]
