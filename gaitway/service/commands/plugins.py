"""`gaitway plugins`: the packages that add terms and bodies to this installation."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from gaitway.cli.common import AsJson, complain, print_json
from gaitway.service.commands.services import require
from gaitway.service.installed import use_code


def plugins(
    name: Annotated[
        str | None, typer.Argument(help="Only this one, with its terms as a table in Markdown.")
    ] = None,
    describe: Annotated[
        bool,
        typer.Option(
            "--describe", help="Write inventories.json, which the API reads in place of the models' files."
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List the packages here that add terms and bodies (entry points `gaitway.environments`).

    Exit code 1 if one could not be loaded, or there is none of that name.
    """
    use_code()
    require("api", "pydantic_settings", "structlog")
    from core.environments.plugins import installed

    chosen = [plugin for plugin in installed() if name in (None, plugin.name)]
    if name is not None and not chosen:
        complain(f"No package here has the entry point {name!r} in the group gaitway.environments.")
        raise typer.Exit(1)
    if describe:
        for plugin in chosen:
            print(_describe(plugin))
        return
    if as_json:
        print_json([_document(plugin) for plugin in chosen])
    elif name is not None and not chosen[0].problem:
        from core.environments.describe_terms import page_of_plugin

        print(page_of_plugin(chosen[0]), end="")
    else:
        if not chosen:
            print("No package here adds terms or bodies.")
        for plugin in chosen:
            print(f"{plugin.name:<20}  {plugin.label} {plugin.code}  {plugin.problem or _has(plugin)}")
    raise typer.Exit(1 if any(plugin.problem for plugin in chosen) else 0)


def _describe(plugin: Any) -> Path:
    """Returns the file. Exits with 1 where the models cannot be read."""
    require("worker", "mujoco")
    from core.environments.describe_bodies import bodies_of_plugin
    from core.environments.plugins import BadPlugin, table_path
    from core.errors import JobFailed

    try:
        table = bodies_of_plugin(plugin)
    except (BadPlugin, JobFailed) as error:
        complain(f"{plugin.name}: {error}")
        raise typer.Exit(1) from None
    if plugin.module is None:
        complain(f"{plugin.name}: {plugin.problem}")
        raise typer.Exit(1)
    path = table_path(plugin.module)
    path.write_text(json.dumps(table, indent=1) + "\n")
    return path


def _has(plugin: Any) -> str:
    return ", ".join([*plugin.kinds, *(row.id for row in plugin.rows)])


def _document(plugin: Any) -> dict[str, Any]:
    return {
        "name": plugin.name,
        "package": plugin.package,
        "version": plugin.version,
        "code": plugin.code,
        "terms": plugin.kinds,
        "bodies": [row.id for row in plugin.rows],
        "problem": plugin.problem or None,
        "loads": list(plugin.loads),
    }
