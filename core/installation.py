"""How this code was installed: by the wheel, which has it in `gaitway/_service`, or as a clone."""

from pathlib import Path

IS_WHEEL = Path(__file__).parents[1].name == "_service"


def to_install(extra: str) -> str:
    """The command that installs an extra of this project."""
    return f"pip install 'gaitway[{extra}]'" if IS_WHEEL else f"uv sync --inexact --extra {extra}"


def to_install_robots() -> str:
    """The command that installs the models of robots. pip must be told that their package needs nothing: its
    code, which is never run, would bring PyTorch and another MuJoCo."""
    return "pip install --no-deps mjlab==1.6.0" if IS_WHEEL else "uv sync --inexact --group robots"
