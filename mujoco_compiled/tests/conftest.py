"""The library's tests need nothing of the service: `python -m pytest tests` runs them in its folder alone."""

import pytest

from mujoco_compiled.code import kept_code


def pytest_configure(config: pytest.Config) -> None:
    for mark, when in (("extra", "more of the same"), ("slow", "takes more than half a minute")):
        config.addinivalue_line("markers", f"{mark}: {when}")


@pytest.fixture(scope="session", autouse=True)
def code_of_earlier_runs(pytestconfig: pytest.Config) -> None:
    """The code that tests make is kept for later runs, unless a larger run of tests keeps it already."""
    if kept_code._folder is None and pytestconfig.cache is not None:
        kept_code.keep_code(pytestconfig.cache.mkdir("mujoco_compiled"))
