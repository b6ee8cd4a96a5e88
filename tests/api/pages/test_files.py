"""The page's files: what they are made of, and how they are served."""

import gzip
import re

import httpx
import pytest

from api.page_files import page_files
from gaitway.service.vendoring import (
    ROOT,
    NotAsLocked,
    NpmPackage,
    VendoredFile,
    bring,
    read_lock,
    read_vendored,
    sha512,
)
from tests.api.conftest import Stack
from tests.api.problems import problem

LOCKED = [file for package in read_lock().packages for file in package.files]


@pytest.mark.parametrize("file", LOCKED, ids=lambda file: file.path)
def test_a_vendored_file_is_the_locked_one(file: VendoredFile) -> None:
    assert sha512(read_vendored(ROOT / file.path)) == file.sha512


def test_every_vendored_file_is_locked_and_every_package_has_its_licence() -> None:
    folder = ROOT / "api" / "pages" / "vendor"
    there = {path.relative_to(ROOT).as_posix() for path in folder.rglob("*") if path.is_file()}
    locked = {file.path for file in LOCKED if file.path.startswith("api/")}
    assert there - locked == {"api/pages/vendor/lock.json"}
    for package in read_lock().packages:
        assert package.licence
        assert any("licence" in file.path for file in package.files), package.name


def test_an_archive_with_another_digest_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def fetch(package: NpmPackage, folder: object) -> object:
        return ROOT / "LICENSE"

    monkeypatch.setattr("gaitway.service.vendoring._fetch", fetch)
    package = NpmPackage(name="x", version="1", licence="MIT", integrity="sha512-other", files=[])
    with pytest.raises(NotAsLocked, match="x has the digest"):
        bring(package)


@pytest.mark.parametrize("path", ["/", "/docs"])
def test_the_pages_run_no_script_but_their_files(stack: Stack, path: str) -> None:
    page = stack.http.get(path)
    assert page.headers["Content-Type"] == "text/html; charset=utf-8"
    policy = page.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert re.findall(r"https?://", page.text) == []
    assert re.findall(r"<script(?![^>]*\bsrc=)", page.text) == []
    for address in re.findall(r'(?:src|href)="(/pages/[^"]+)"', page.text):
        assert stack.http.get(address).status_code == 200, address


def test_a_files_address_changes_with_it_so_that_browsers_keep_it(stack: Stack) -> None:
    here = f"/pages/{page_files().version}/app.js"
    assert "immutable" in stack.http.get(here).headers["Cache-Control"]
    assert here.rpartition("/")[0] in stack.http.get("/").text
    # As another version's process would be asked while both run.
    other = stack.http.get("/pages/000000000000/app.js")
    assert other.headers["Cache-Control"] == "no-cache"
    assert other.text == stack.http.get(here).text


def test_files_come_compressed_to_those_who_can_read_that(stack: Stack) -> None:
    address = f"{stack.http.base_url}/pages/{page_files().version}/app.js"
    with httpx.stream("GET", address, headers={"Accept-Encoding": "gzip"}) as answer:
        assert answer.headers["Content-Encoding"] == "gzip"
        assert gzip.decompress(b"".join(answer.iter_raw())) == page_files().by_path["app.js"].content
    plain = httpx.get(address, headers={"Accept-Encoding": "identity"})
    assert "Content-Encoding" not in plain.headers


def test_webassembly_is_stored_compressed_and_allowed_in_its_worker_alone(stack: Stack) -> None:
    here = f"{stack.http.base_url}/pages/{page_files().version}"
    with httpx.stream("GET", f"{here}/vendor/mujoco.wasm", headers={"Accept-Encoding": "gzip"}) as answer:
        assert answer.headers["Content-Type"] == "application/wasm"
        stored = (ROOT / "api" / "pages" / "vendor" / "mujoco.wasm.gz").read_bytes()
        assert b"".join(answer.iter_raw()) == stored
    plain = httpx.get(f"{here}/vendor/mujoco.wasm", headers={"Accept-Encoding": "identity"})
    assert plain.content[:4] == b"\0asm"
    policies = {
        path: httpx.get(f"{here}/{path}").headers["Content-Security-Policy"]
        for path in ("app.js", "lib/push/simulation.js", "lib/push/worker.js", "vendor/mujoco.js")
    }
    allowed = [path for path, policy in policies.items() if "script-src 'self' 'wasm-unsafe-eval'" in policy]
    assert allowed == ["lib/push/worker.js"]


@pytest.mark.parametrize("path", ["nothing.js", "../app.py", "%2e%2e/app.py", "vendor"])
def test_there_is_nothing_else_to_get(stack: Stack, path: str) -> None:
    problem(stack.http.get(f"/pages/{page_files().version}/{path}"), 404, "route-not-found")
