"""The algorithms a job may name. To add one: a member of the union here, and its arm in `worker.trainers`."""

from core.algorithms.ppo.spec import PPOSpec

# A union discriminated by `kind` once it has a second member.
AlgorithmSpec = PPOSpec

ALGORITHMS: dict[str, type[AlgorithmSpec]] = {"ppo": PPOSpec}
