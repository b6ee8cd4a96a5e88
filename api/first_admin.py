"""`python -m api.first_admin`: makes the first admin of a service with accounts. Composition root."""

import argparse
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from core.accounts.first_admin import first_admin, name_here, new_file
from core.configuration import read, stopping_if_misconfigured
from core.errors import Conflict, Unavailable
from core.settings import StoreSettings


@stopping_if_misconfigured()
def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 1 if there is an admin already, or the record cannot be reached."""
    from core.adapters.wiring import job_store

    parser = argparse.ArgumentParser(prog="python -m api.first_admin", description=__doc__)
    parser.add_argument("--name", default=name_here(), help="of the user; default: %(default)s")
    parser.add_argument("--file", type=Path, help="where the token goes; by default to stdout")
    parser.add_argument("--anyway", action="store_true", help="although there is an admin")
    chosen = parser.parse_args(arguments)
    store = job_store(read(StoreSettings), pool_size=0)
    try:
        # Opened first: nobody could read the token of an admin whose file cannot be made.
        with nullcontext(sys.stdout) if chosen.file is None else new_file(chosen.file) as file:
            secret = first_admin(store, chosen.name, anyway=chosen.anyway)
            if secret is None:
                raise ValueError(
                    "There is an admin already, who makes others by `gaitway users add`; --anyway makes one "
                    "more."
                )
            file.write(f"{secret.text}\n")
    except (OSError, ValueError, Conflict, Unavailable) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    where = "" if chosen.file is None else f" Its token is in {chosen.file}: `gaitway login < {chosen.file}`."
    sys.stderr.write(f"{chosen.name} is an admin.{where}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
