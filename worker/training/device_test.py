"""`python -m worker.training.device_test NUM_GPUS`: copies and multiplies numbers on each card that it sees.

Exit status 0 if all is well; otherwise the last line says what is wrong.
"""

import os
import sys
from typing import Any

from worker.host.processes import die_with_parent

_SIZE = 1024


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
