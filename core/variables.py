"""How the environment names a setting; apart from the settings, which take 0.3 s to load."""

PREFIX = "GAITWAY_"


def variable(field: str) -> str:
    return f"{PREFIX}{field.upper()}"
