"""Makes the table of Brax's registry: `python -m core.environments.external.brax.describe`."""

import json
from importlib.metadata import version
from typing import Any

import jax

from core.environments.external.brax.environment import Brax
from core.environments.external.brax.info import BACKENDS, TABLE


def table() -> dict[str, Any]:
    """Facts on each environment in the installed package's registry, under each of its physics."""
    from brax import envs

    found: dict[str, Any] = {}
    cannot: dict[str, str] = {}
    for name in envs._envs:  # pyright: ignore[reportPrivateUsage] - it has no public list
        if name == "fast":
            cannot[name] = "it is made for Brax's own tests: it has no body"
            continue
        try:
            found[name] = facts({backend: Brax(name, backend) for backend in BACKENDS})
        except Exception as error:  # a foreign package may fail with anything
            cannot[name] = f"brax {version('brax')} cannot step it with jax {jax.__version__} ({error})"
    return {"package": f"brax {version('brax')}", "environments": found, "cannot": cannot}


def facts(by_backend: dict[str, Brax]) -> dict[str, Any]:
    """The facts on an environment; all but dt are the same under each physics."""
    one = by_backend["generalized"]
    return {
        "observation_size": one.observation_size,
        "action_size": one.action_size,
        "dt": {backend: round(environment.dt, 6) for backend, environment in by_backend.items()},
        "tracked_body": one.model.body(one.tracked_body).name,
        "cameras": [one.model.camera(number).name for number in range(one.model.ncam)],
    }


if __name__ == "__main__":
    TABLE.write_text(json.dumps(table(), indent=1) + "\n")
