"""Starts the service on this machine and stays: `./run up`, `gaitway up`."""

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from gaitway.local import announced
from gaitway.service.embedded.interruption import Interrupted
from gaitway.service.embedded.processes import ServerFailed
from gaitway.service.embedded.stack import Stack
from gaitway.service.installed import PROGRAM, data_folder

# Most people train this environment first.
_PREPARED = "ant"


def report(sentence: str) -> None:
    """One line for the user, at once."""
    print(sentence, file=sys.stderr, flush=True)


def run_stack(data_dir: Path, *, port: int | None = None, num_workers: int = 1) -> int:
    """Serve until Ctrl-C, SIGTERM or SIGHUP; the exit status."""
    try:
        with Stack(data_dir, port=port, num_workers=num_workers, prepare=_PREPARED, report=report) as stack:
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
    parser.add_argument("--data", type=Path, default=data_folder(), metavar="DIR")
    parser.add_argument("--workers", type=not_negative, default=1, metavar="N")
    chosen = parser.parse_args(arguments)
    return run_stack(chosen.data, port=chosen.port, num_workers=chosen.workers)


if __name__ == "__main__":
    sys.exit(main())
