"""Clips of a body's own gaits, as a file that `POST /clips` and `bench.imitation` take.

A policy of each seed is trained by the body's tuned settings; episodes of it at several stages of the
training, which move at different speeds, are recorded by C MuJoCo, without noise of actions. The clips of the
last seed are kept apart, so that a tracker has not seen their policy. `python -m bench.recordings --gpu
--body rodent --out DIR` writes `DIR/rodent.npz` and `DIR/rodent-unseen.npz`; with `--unseen 0` only the
first, of all seeds.
"""

import argparse
import os
from pathlib import Path

from bench.child import run_child


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.recordings", description=__doc__)
    parser.add_argument("--gpu", action="store_true", help="on the first GPU, not on all cores")
    parser.add_argument("--body", default="rodent", metavar="BODY", help="of the catalog")
    parser.add_argument("--steps", type=int, metavar="N", help="of a training; by default tuned")
    parser.add_argument("--seeds", type=int, default=2, metavar="N", help="how many")
    parser.add_argument("--first-seed", type=int, default=0, metavar="N", help="the others follow it")
    parser.add_argument("--stages", type=int, default=3, metavar="N", help="of each training")
    parser.add_argument("--clips", type=int, default=40, metavar="N", help="of all seeds but the last")
    parser.add_argument("--unseen", type=int, default=10, metavar="N", help="of the last seed")
    parser.add_argument("--seconds", type=float, default=3.0, metavar="S", help="of a clip")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    arguments = parser.parse_args()
    if arguments.seeds < 2 and arguments.unseen > 0:
        parser.error("the clips of the last seed are kept apart: ask for two seeds, or for --unseen 0.")
    arguments.out.mkdir(parents=True, exist_ok=True)
    request = {
        "body": arguments.body,
        "settings": {} if arguments.steps is None else {"num_timesteps": arguments.steps},
        "seeds": list(range(arguments.first_seed, arguments.first_seed + arguments.seeds)),
        "stages": arguments.stages,
        "clips": arguments.clips,
        "unseen": arguments.unseen,
        "seconds": arguments.seconds,
        "device": "gpu" if arguments.gpu else "cpu",
        "cache": str(arguments.out.absolute() / "compiled"),
        "out": str(arguments.out.absolute()),
    }
    told = run_child("bench.children.record_clips", request, timeout_s=3600.0, environment=os.environ)
    for row in told["clips"]:
        print(f"{row['file']}: {row['name']}, {row['seconds']:.2f} s, {row['speed']:.2f} m/s")


if __name__ == "__main__":
    main()
