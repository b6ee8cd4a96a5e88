"""Starts the service on this machine and stays: `./run up`, `gaitway up`."""

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from core.errors import EXIT_STATUS
from core.variables import variable
from gaitway.local import announced
from gaitway.service.embedded.interruption import Interrupted
from gaitway.service.embedded.processes import ServerFailed
from gaitway.service.embedded.stack import LOOPBACK, Stack
from gaitway.service.installed import PROGRAM, data_folder

# Most people train this environment first.
_PREPARED = "ant"
# In the data folder, until somebody removes it.
FIRST_ADMIN = "first-admin.token"


def report(sentence: str) -> None:
    """One line for the user, at once."""
    print(sentence, file=sys.stderr, flush=True)


def run_stack(
    data_dir: Path,
    *,
    host: str = LOOPBACK,
    port: int | None = None,
    num_workers: int = 1,
    accounts: bool = False,
) -> int:
    """Serve until Ctrl-C, SIGTERM or SIGHUP; the exit status.

    accounts: let users have them, and make the first admin; without, GAITWAY_ACCOUNTS decides.
    """
    accounts = accounts or os.environ.get(variable("accounts"), "").lower() in ("1", "true", "yes", "on")
    if not accounts and host not in (LOOPBACK, "::1", "localhost"):
        report(
            f"Without accounts the service does not listen at {host}: anyone who reaches that address could "
            "read, cancel and delete everything. Say --accounts (docs/teams.md), or leave --host out and "
            "reach it by `ssh -L 8000:127.0.0.1:8000 thatmachine`."
        )
        return EXIT_STATUS
    parts = Stack(
        data_dir,
        host=host,
        port=port,
        num_workers=num_workers,
        accounts=accounts,
        prepare=_PREPARED,
        report=report,
    )
    try:
        with parts as stack:
            if accounts:
                _make_first_admin(stack)
            print(f"Gaitway is at {stack.url}  (its interface: {stack.url}/docs)", flush=True)
            print(f"Data and logs are in {stack.data_dir}. Ctrl-C ends it.", flush=True)
            try:
                with ExitStack() as while_it_runs:
                    _leave_address(stack.url, while_it_runs)
                    stack.watch()
            except Interrupted:
                report("Ending; running jobs save a checkpoint first (Ctrl-C again: at once).")
    except ServerFailed as failed:
        report(str(failed))
        return 1
    except Interrupted as interrupted:
        return interrupted.exit_status
    return 0


def _make_first_admin(stack: Stack) -> None:
    """An admin named as this system's user, unless there is one; the token is left in the data folder."""
    from core.accounts.first_admin import first_admin, name_here, new_file
    from core.adapters.postgres.engine import connect_postgres
    from core.adapters.postgres.store import PostgresJobStore

    store = PostgresJobStore(connect_postgres(stack.store_settings[variable("database_url")], pool_size=0))
    file = stack.data_dir / FIRST_ADMIN
    if (secret := first_admin(store, name := name_here())) is not None:
        file.unlink(missing_ok=True)
        with new_file(file) as opened:
            opened.write(f"{secret.text}\n")
        report(f"The first admin is {name}; the token is in {file}: `gaitway login < {file}`.")


def _leave_address(url: str, while_it_runs: ExitStack) -> None:
    try:
        while_it_runs.enter_context(announced(url))
    except (OSError, RuntimeError) as error:  # RuntimeError: this user has no home.
        report(f"Clients do not find it by themselves ({error}): set GAITWAY_URL={url}.")


def positive(text: str) -> int:
    """A whole number above zero, for argparse."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is not above zero")
    return number


def not_negative(text: str) -> int:
    """A whole number, for argparse."""
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"{number} is below zero")
    return number


def port_number(text: str) -> int:
    """A TCP port, for argparse."""
    number = positive(text)
    if number > 65_535:
        raise argparse.ArgumentTypeError(f"{number} is not a port: 1 to 65535")
    return number


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog=f"{PROGRAM} up", description="Start the service on this machine and stay."
    )
    parser.add_argument("--port", type=port_number, help="of the API; by default 8000 or the next free one")
    parser.add_argument("--host", default=LOOPBACK, help="where it listens; another one needs --accounts")
    parser.add_argument("--accounts", action="store_true", help="users have accounts; makes the first admin")
    parser.add_argument("--data", type=Path, default=data_folder(), metavar="DIR")
    parser.add_argument("--workers", type=not_negative, default=1, metavar="N")
    chosen = parser.parse_args(arguments)
    return run_stack(
        chosen.data,
        host=chosen.host,
        port=chosen.port,
        num_workers=chosen.workers,
        accounts=chosen.accounts,
    )


if __name__ == "__main__":
    sys.exit(main())
