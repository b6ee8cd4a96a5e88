"""The process of a cohort, without numbers: it ends when all members have left. It is given descriptors."""

import sys
from contextlib import suppress
from multiprocessing.connection import Connection, wait


def main() -> None:
    members = [Connection(int(descriptor)) for descriptor in sys.argv[1:]]
    while members:
        for member in wait(members):
            assert isinstance(member, Connection)
            with suppress(EOFError, OSError):
                member.recv_bytes()
                continue
            members.remove(member)


if __name__ == "__main__":
    from worker.host.parent_death import die_with_parent

    die_with_parent()
    main()
