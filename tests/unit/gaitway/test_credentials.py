"""The file of `gaitway login`: one token for each address, and for nobody else to read."""

import pickle
import stat
from pathlib import Path

import platformdirs
import pytest

from gaitway import Client, credentials
from gaitway.errors import UnsafeFile

URL, OTHER = "http://lab:8000", "http://127.0.0.1:8000"


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.delenv(credentials.VARIABLE, raising=False)


def test_it_is_where_other_programs_keep_theirs_and_private() -> None:
    assert credentials.token_for(URL) is None
    path = credentials.store(URL, "one")
    assert path.parent == platformdirs.user_config_path("gaitway", appauthor=False)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    credentials.store(OTHER, "two")
    assert (credentials.token_for(URL), credentials.token_for(OTHER)) == ("one", "two")
    assert credentials.forget(URL)
    assert not credentials.forget(URL)
    assert (credentials.token_for(URL), credentials.token_for(OTHER)) == (None, "two")
    assert [one.name for one in path.parent.iterdir()] == [path.name]


def test_a_link_in_the_place_of_the_new_file_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, other = credentials.store(URL, "one"), tmp_path / "other"
    other.write_text("whole")
    monkeypatch.setattr(credentials.secrets, "token_hex", lambda _: "guessed")
    path.with_suffix(".guessed").symlink_to(other)
    with pytest.raises(FileExistsError):
        credentials.store(URL, "two")
    assert (other.read_text(), credentials.token_for(URL)) == ("whole", "one")


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o666])
def test_a_file_that_others_can_read_is_refused_with_the_remedy(mode: int) -> None:
    path = credentials.store(URL, "one")
    path.chmod(mode)
    for use in (lambda: credentials.token_for(URL), lambda: credentials.store(URL, "two")):
        with pytest.raises(UnsafeFile, match=f"chmod 600 {path}"):
            use()


def test_a_damaged_file_says_so() -> None:
    path = credentials.store(URL, "one")
    path.write_text("{")
    with pytest.raises(UnsafeFile, match="is damaged"):
        credentials.token_for(URL)


def test_the_variable_wins_over_the_file_and_the_argument_over_both(monkeypatch: pytest.MonkeyPatch) -> None:
    credentials.store(URL, "stored")
    assert _sent(Client(URL)) == "Bearer stored"
    assert _sent(Client(OTHER)) is None  # No other service sees it.
    monkeypatch.setenv(credentials.VARIABLE, "named")
    assert _sent(Client(URL)) == "Bearer named"
    client = Client(URL, token="given")
    assert _sent(client) == _sent(pickle.loads(pickle.dumps(client))) == "Bearer given"  # noqa: S301
    assert "given" not in repr(client)


def _sent(client: Client) -> str | None:
    with client:
        return client._credentials.get("Authorization")
