"""One of several processes that share a run: `python -m tests.learning.on_hosts HOSTS RANK PORT OUT`.

The first writes the run's checkpoints into the folder OUT. With one host, the process has two devices;
several also resume from the first checkpoint, and the last one is then `resumed`.
"""

import sys
import time
from collections.abc import Mapping
from pathlib import Path

from tests import probes
from tests.kept_programs import keep_programs
from tests.learning.runs import STEPS_PER_UPDATE, checkpoints, small_run
from worker.protocol import GangPart
from worker.training import hosts


def main(num_hosts: int, rank: int, port: str, out: Path) -> None:
    if num_hosts > 1:
        hosts.join(GangPart(hosts=num_hosts, rank=rank, coordinator=f"127.0.0.1:{port}"))
    half, end = STEPS_PER_UPDATE, 2 * STEPS_PER_UPDATE
    kept = trained(rank, end)
    for step, content in kept.items():
        (out / str(step)).write_bytes(content)
    if num_hosts > 1:
        first = out / "first"
        if rank == 0:  # Whole, before the others see it.
            (out / "part").write_bytes(kept[half])
            (out / "part").rename(first)
        while not first.exists():
            time.sleep(0.01)
        resumed = trained(rank, end, resume=first.read_bytes())
        if rank == 0:
            (out / "resumed").write_bytes(resumed[end])
    hosts.leave(0)


def trained(rank: int, num_timesteps: int, resume: bytes | None = None) -> Mapping[int, bytes]:
    """The run's checkpoints in the first process; the others take part, and have none."""
    run = small_run(
        probes.observed_action_reward(),
        devices=2,
        checkpoint_every_steps=STEPS_PER_UPDATE,
        num_timesteps=num_timesteps,
        resume=resume,
        episode_length=5,
        num_evals=2,
        reset_pool_size=12,
    )
    if rank > 0:
        run.follow()
        return {}
    kept = checkpoints(run)
    run.end()
    return kept


if __name__ == "__main__":
    keep_programs()
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], Path(sys.argv[4]))
