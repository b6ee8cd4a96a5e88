"""Where this user's programs keep their data, and how a client finds a service of this machine."""

import subprocess
import sys
from pathlib import Path

import platformdirs
import pytest

from gaitway.addresses import DEFAULT_URL, address
from gaitway.local import announced, running, user_data_folder

pytestmark = pytest.mark.usefixtures("home")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    monkeypatch.delenv("GAITWAY_URL", raising=False)


@pytest.mark.parametrize("named", [None, "", "/elsewhere"])
def test_the_data_folder_is_where_other_programs_have_theirs(
    named: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    if named is not None:
        monkeypatch.setenv("XDG_DATA_HOME", named)
    assert user_data_folder() == platformdirs.user_data_path("gaitway", appauthor=False)


def test_a_client_finds_the_newest_service_as_long_as_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    assert address(None) == DEFAULT_URL
    with announced("http://127.0.0.1:8001"):
        assert address(None) == "http://127.0.0.1:8001"
        with announced("http://127.0.0.1:9000"):
            assert address(None) == "http://127.0.0.1:9000"
        assert address(None) == "http://127.0.0.1:8001"
        monkeypatch.setenv("GAITWAY_URL", "http://elsewhere")
        assert address(None) == "http://elsewhere"
        assert address("http://there") == "http://there"
    assert running() is None


def test_a_service_that_was_killed_is_not_found() -> None:
    program = (
        "import sys; from gaitway.local import announced\n"
        "with announced('http://127.0.0.1:8001'): print('left', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdin=-1, stdout=-1) as service:
        assert service.stdout is not None
        service.stdout.readline()
        assert running() == "http://127.0.0.1:8001"
        service.kill()
        service.wait()
        assert [file.name for file in user_data_folder().rglob("8001")] == ["8001"]
        assert running() is None
