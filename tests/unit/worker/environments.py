"""The variables under which a process of the service reads the settings of a test."""

import os

from pydantic import SecretStr

from core.settings import WorkerSettings


def environment(settings: WorkerSettings, **others: str) -> dict[str, str]:
    """This process's, without any setting of its own; others: further variables."""
    given = {
        name: value.get_secret_value() if isinstance(value, SecretStr) else str(value)
        for name, value in settings
        if name in settings.model_fields_set
    }
    outer = {name: value for name, value in os.environ.items() if not name.startswith("GAITWAY_")}
    return {**outer, **{f"GAITWAY_{name.upper()}": value for name, value in given.items()}, **others}
