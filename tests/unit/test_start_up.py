"""A lean start: a package that is put off, and then wanted."""

import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from core.start_up import put_off

PACKAGE = """
import os
os.environ["HEAVY_LOADED"] = os.environ.get("HEAVY_LOADED", "") + "once"
from heavy.body import Body
"""
# It asks the package for a part of it while the package would ask it for Body.
BODY = """
from heavy import mind
class Body: ...
"""


@pytest.fixture
def heavy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A package that tells when its `__init__` runs; it uses its part `body`, and not `mind`."""
    (tmp_path / "heavy").mkdir()
    (tmp_path / "heavy/__init__.py").write_text(PACKAGE)
    (tmp_path / "heavy/body.py").write_text(BODY)
    (tmp_path / "heavy/mind.py").write_text("thought = 42")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("HEAVY_LOADED", "")
    yield
    for name in ("heavy", "heavy.body", "heavy.mind"):
        sys.modules.pop(name, None)


@pytest.mark.usefixtures("heavy")
def test_parts_are_loaded_without_the_package_and_the_package_when_it_is_asked_for() -> None:
    put_off("heavy")
    assert importlib.import_module("heavy.mind").thought == 42
    package = importlib.import_module("heavy")
    assert not hasattr(package, "__wrapped__")  # what inspect asks of everything
    assert os.environ["HEAVY_LOADED"] == ""
    assert package.Body is importlib.import_module("heavy.body").Body
    assert not hasattr(package, "nothing")
    assert package.Body.__name__ == "Body"
    assert os.environ["HEAVY_LOADED"] == "once"


@pytest.mark.usefixtures("heavy")
def test_a_part_that_asks_for_another_part_does_not_load_the_package() -> None:
    put_off("heavy")
    assert importlib.import_module("heavy.body").mind.thought == 42
    assert os.environ["HEAVY_LOADED"] == ""


@pytest.mark.usefixtures("heavy")
def test_a_package_that_is_loaded_already_stays_as_it_is() -> None:
    package = importlib.import_module("heavy")
    put_off("heavy")
    assert importlib.import_module("heavy") is package


def test_a_package_that_is_not_there_is_no_matter() -> None:
    put_off("no_such_package_at_all")
    assert "no_such_package_at_all" not in sys.modules


def test_a_lean_start_leaves_the_window_system_alone_until_it_is_asked_for() -> None:
    code = (
        "import sys; from core.start_up import start_lean; start_lean(); import mujoco; "
        "print(mujoco.Renderer.__name__, 'glfw.library' in sys.modules, mujoco.GLContext.__name__)"
    )
    variables = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["Renderer", "False", "GLContext"]
