"""`python -m worker.training.device_test NUM_GPUS`: copies and multiplies numbers on each card that it sees,
and adds up numbers over several of them, as a training on them does.

Exit status 0 if all is well; otherwise the last line says what is wrong.
"""

import os
import sys
from collections.abc import Sequence
from typing import Any

from worker.host.device_health import EACH_WORKS
from worker.host.processes import die_with_parent

_SIZE = 1024
# 16 MiB on each card: NCCL sends what is small another way.
_NUM_ADDED = 2**22


def main(num_gpus: int) -> None:
    die_with_parent()
    # The test must not take all of a card's memory.
    os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
    import jax

    found = jax.devices()
    if found[0].platform != "gpu" or len(found) < num_gpus:
        sys.exit(f"JAX finds only {', '.join(map(str, found))}.")
    for card in found:
        _test(card)
    if len(found) > 1:
        # Before the sum: cards that cannot reach each other often wait for ever.
        print(EACH_WORKS, flush=True)  # noqa: T201
        test_together(found)


def test_together(cards: Sequence[Any]) -> None:
    """Exits with a sentence if a sum over these cards fails, or is wrong."""
    import jax
    import numpy as np
    from jax.sharding import Mesh, NamedSharding, PartitionSpec

    mesh = Mesh(np.array(cards), ("cards",))
    one_each, on_all = (NamedSharding(mesh, PartitionSpec(*names)) for names in (["cards"], []))
    numbers = np.arange(len(cards), dtype=np.float32)[:, None] + np.ones(_NUM_ADDED, np.float32)
    try:
        rows = jax.device_put(numbers, one_each)
        added = jax.jit(lambda rows: rows.sum(axis=0), out_shardings=on_all)(rows)
        copies = [np.asarray(copy.data) for copy in added.addressable_shards]
    except Exception as error:
        sys.exit(f"These cards do not work together: {str(error).splitlines()[0]}")
    if any(not np.array_equal(copy, numbers.sum(axis=0)) for copy in copies):
        sys.exit("These cards do not work together: they add up wrongly.")


def _test(card: Any) -> None:
    import jax
    import numpy as np

    # Small whole numbers, so that every sum is exact in whatever precision the card multiplies.
    numbers = np.random.default_rng(0).integers(-3, 4, (_SIZE, _SIZE)).astype(np.float32)
    there = jax.device_put(numbers, card)
    if not np.array_equal(np.asarray(there), numbers):
        sys.exit(f"{card} returns other bytes than it was given.")
    if not np.array_equal(np.asarray(there @ there), numbers @ numbers):
        sys.exit(f"{card} multiplies wrongly.")


if __name__ == "__main__":
    main(int(sys.argv[1]))
