"""The environment variable of a setting; separate from core.settings, which takes 0.3 s to import."""

PREFIX = "GAITWAY_"


def variable(field: str) -> str:
    return f"{PREFIX}{field.upper()}"
