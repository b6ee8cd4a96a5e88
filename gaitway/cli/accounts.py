"""`gaitway login`, `logout`, `whoami`, `users`, `projects`, `tokens` and `audit`: a service with accounts."""

import getpass
import sys
from datetime import datetime
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from gaitway import credentials
from gaitway.addresses import address
from gaitway.cli.common import AsJson, client_of, complain, print_json, wrong_usage
from gaitway.cli.terminal import Console
from gaitway.client import Client
from gaitway.schema import AuditView, ProjectView, TokenView, UserView, WhoView

users = typer.Typer(help="Users, for an admin.", no_args_is_help=True)
projects = typer.Typer(help="Projects, and who sees what is in them.", no_args_is_help=True)
tokens = typer.Typer(help="API tokens: your own, and for an admin all.", no_args_is_help=True)
Server = Annotated[
    str | None,
    typer.Option("--server", metavar="URL", help="By default that of --url, GAITWAY_URL, or here."),
]
UserName = Annotated[str, typer.Argument(metavar="USER")]
ProjectName = Annotated[str, typer.Argument(metavar="PROJECT")]
_Role = Annotated[str, typer.Option(help="viewer, submitter or admin")]


def login(context: typer.Context, server: Server = None) -> None:
    """Store your token for a service: it is asked for without echo, or read from stdin."""
    url = address(server or context.find_object(str))
    text = getpass.getpass(f"Token for {url}: ") if sys.stdin.isatty() else sys.stdin.readline()
    token = text.strip()
    if not token:
        raise wrong_usage("No token was given; an admin makes one by `gaitway tokens create`.")
    with Client(url, token=token) as client:
        who = client.whoami()
    if not who.accounts:
        complain(f"The service at {url} has no accounts, and needs no token; nothing was stored.")
        raise typer.Exit(1)
    path = credentials.store(url, token)
    print(f"{_sentence(who, url)} The token is in {path}.")


def logout(context: typer.Context, server: Server = None) -> None:
    """Forget the stored token for a service. It stays valid: `gaitway tokens revoke` ends it."""
    url = address(server or context.find_object(str))
    print(f"The token for {url} is {'forgotten' if credentials.forget(url) else 'not stored here'}.")


def whoami(context: typer.Context, as_json: AsJson = False) -> None:
    """Show who you are for the service, and what you may do."""
    client = client_of(context)
    who = client.whoami()
    if as_json:
        print_json(who)
    else:
        print(_sentence(who, client.base_url))


def _sentence(who: WhoView, url: str) -> str:
    if not who.accounts:
        return f"The service at {url} has no accounts: everybody who reaches it may do everything."
    ends = f", until {_moment(who.expires_at)}" if who.expires_at else ""
    inside = f"in {', '.join(who.projects)}" if who.projects else "in no project"
    return f"You are {who.user} at {url}: {who.role}, by a token of the scope {who.scope}{ends}; {inside}."


@tokens.command("create")
def create_token(
    context: typer.Context,
    scope: Annotated[str, typer.Option(help="read, submit, admin or worker")] = "submit",
    name: Annotated[str, typer.Option(help="What it is for, such as the machine's name.")] = "",
    user: Annotated[str | None, typer.Option(help="Whose; by default yours.")] = None,
    days: Annotated[int, typer.Option(help="Until it expires; 0: never.", min=0)] = 90,
    as_json: AsJson = False,
) -> None:
    """Make a token. Its secret is printed once, on stdout."""
    client = client_of(context)
    made = client.create_token(scope, name=name, user=user, expires_in_days=days or None)
    if as_json:
        print_json(made)
        return
    ends = f"until {_moment(made.expires_at)}" if made.expires_at else "for ever"
    complain(f"A token of the scope {made.scope} for {made.user}, {ends}. It is shown this once:")
    print(made.secret)


@tokens.command("list")
def list_tokens(
    context: typer.Context,
    user: Annotated[str | None, typer.Option(help="Only this user's.")] = None,
    as_json: AsJson = False,
) -> None:
    """List tokens, without their secrets."""
    found = client_of(context).tokens(user)
    if as_json:
        print_json(found)
    else:
        _print(("TOKEN", "USER", "NAME", "SCOPE", "LAST USE", "STATE"), [_token_row(one) for one in found])


@tokens.command("revoke")
def revoke_token(
    context: typer.Context, token: Annotated[str, typer.Argument(metavar="TOKEN", help="Its id.")]
) -> None:
    """Revoke a token; within two seconds nothing accepts it any more."""
    client_of(context).revoke_token(token)
    print(f"The token {token} is revoked.")


@users.command("add")
def add_user(
    context: typer.Context,
    name: UserName,
    role: _Role = "submitter",
    project: Annotated[list[str] | None, typer.Option(help="Repeatable; by default `default`.")] = None,
) -> None:
    """Add a user. `gaitway tokens create --user` makes their first token."""
    user = client_of(context).add_user(name, role, projects=project or ["default"])
    print(f"{user.name} is a {user.role} in {', '.join(user.projects)}.")


@users.command("list")
def list_users(context: typer.Context, as_json: AsJson = False) -> None:
    """List users."""
    found = client_of(context).users()
    if as_json:
        print_json(found)
    else:
        _print(("USER", "ROLE", "PROJECTS", "STATE"), [_user_row(one) for one in found])


@users.command("role")
def give_role(
    context: typer.Context,
    name: UserName,
    role: Annotated[str, typer.Argument(help="viewer, submitter or admin")],
) -> None:
    """Give a user another role."""
    user = client_of(context).change_user(name, role=role)
    print(f"{user.name} is a {user.role}.")


@users.command("disable")
def disable_user(context: typer.Context, name: UserName) -> None:
    """Refuse all of a user's tokens; their jobs stay."""
    client_of(context).change_user(name, active=False)
    print(f"{name} is disabled; `gaitway users enable {name}` lets them in again.")


@users.command("enable")
def enable_user(context: typer.Context, name: UserName) -> None:
    """Let a disabled user in again."""
    client_of(context).change_user(name, active=True)
    print(f"{name} is enabled.")


@users.command("link")
def link_user(
    context: typer.Context,
    name: UserName,
    subject: Annotated[str, typer.Argument(help="ISSUER#ID, as the refused sign-in says it.")],
) -> None:
    """Let an account of the identity provider sign in as a user who is here already."""
    client_of(context).change_user(name, subject=subject)
    print(f"{subject} signs in as {name} from now on.")


@projects.command("add")
def add_project(
    context: typer.Context,
    name: ProjectName,
    member: Annotated[list[str] | None, typer.Option(help="Who is in it; repeatable.")] = None,
) -> None:
    """Add a project, for an admin."""
    client = client_of(context)
    project = client.add_project(name)
    if member:
        project = client.change_members(name, add=member)
    print(_members(project))


@projects.command("list")
def list_projects(context: typer.Context, as_json: AsJson = False) -> None:
    """List your projects, and for an admin all."""
    found = client_of(context).projects()
    if as_json:
        print_json(found)
    else:
        _print(("PROJECT", "MEMBERS"), [(one.name, ", ".join(one.members)) for one in found])


@projects.command("members")
def change_members(
    context: typer.Context,
    name: ProjectName,
    add: Annotated[list[str] | None, typer.Option(help="A user who enters; repeatable.")] = None,
    remove: Annotated[list[str] | None, typer.Option(help="A user who leaves; repeatable.")] = None,
) -> None:
    """Show who is in a project, or change that."""
    client = client_of(context)
    if add or remove:
        project = client.change_members(name, add=add or [], remove=remove or [])
    else:
        project = next((one for one in client.projects() if one.name == name), None)
        if project is None:
            raise wrong_usage(
                f"There is no project {name!r} that you see; `gaitway projects list` shows all."
            )
    print(_members(project))


def audit(
    context: typer.Context,
    user: Annotated[str | None, typer.Option()] = None,
    action: Annotated[str | None, typer.Option(help="Its beginning, such as job. or token.revoked")] = None,
    thing: Annotated[
        str | None,
        typer.Option("--object", metavar="'KIND ID'", help="Such as 'job 019aa3c2f0b1-5be0c1d2e3'."),
    ] = None,
    limit: Annotated[int, typer.Option("--limit", "-n", min=1)] = 50,
    as_json: AsJson = False,
) -> None:
    """Show what was done, by whom and from where, the newest first; for an admin."""
    found = list(client_of(context).audit(user=user, action=action, object=thing, limit=limit))
    if as_json:
        print_json(found)
    else:
        _print(("WHEN", "USER", "ACTION", "OBJECT", "FROM"), [_audit_row(one) for one in found])


def _print(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*map(Text, row))
    Console().print(table)


def _token_row(token: TokenView) -> tuple[str, ...]:
    state = (
        "revoked" if token.revoked_at else f"until {_moment(token.expires_at)}" if token.expires_at else ""
    )
    return token.id, token.user, token.name, token.scope, _moment(token.last_used_at), state


def _user_row(user: UserView) -> tuple[str, ...]:
    return user.name, user.role, ", ".join(user.projects), "" if user.active else "disabled"


def _audit_row(entry: AuditView) -> tuple[str, ...]:
    return _moment(entry.at), entry.user or "-", entry.action, entry.object or "", entry.address or ""


def _members(project: ProjectView) -> str:
    return f"In {project.name}: {', '.join(project.members) or 'nobody'}."


def _moment(moment: datetime | None) -> str:
    return f"{moment.astimezone():%Y-%m-%d %H:%M}" if moment else "never"
