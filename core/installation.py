"""How this code was installed: by the wheel, which has it in `gaitway/_service`, or as a clone."""

from pathlib import Path

IS_WHEEL = Path(__file__).parents[1].name == "_service"


def to_install(extra: str) -> str:
    """The command that installs an extra of this project."""
    return f"pip install 'gaitway[{extra}]'" if IS_WHEEL else f"uv sync --inexact --extra {extra}"
