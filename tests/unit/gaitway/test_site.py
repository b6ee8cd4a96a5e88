"""The documentation as a site, built whole."""

import hashlib
import json
import re
from pathlib import Path

import pytest

from core.jobs.spec import JOB_SPEC
from gaitway.service import site

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site") / "out"
    assert site.main(["--out", str(out)]) == 0
    return out


def test_it_has_every_page_and_asks_no_other_host(built: Path) -> None:
    for page in (ROOT / "docs").rglob("*.md"):
        assert (built / "docs" / page.relative_to(ROOT / "docs")).with_suffix(".html").is_file()
    elsewhere = re.compile(r"<(?:script|link|img|source|iframe)[^>]+(?:src|href)=[\"']?(?:https?:)?//")
    assert [page for page in built.rglob("*.html") if elsewhere.search(page.read_text())] == []


def test_it_describes_the_client_and_the_http_interface(built: Path) -> None:
    client = (built / "docs" / "client_reference.html").read_text()
    assert "gaitway.client.Client.submit" in client
    assert "Queue a job" in client
    script = (built / "interface" / "document.js").read_text()
    assert '"/jobs/{job_id}/video"' in script
    assert (built / "interface" / "swagger-ui.js").is_file()


def test_the_tutorials_job_names_the_model_beside_it() -> None:
    spec = JOB_SPEC.validate_json((ROOT / "examples" / "quadruped.json").read_bytes())
    model = hashlib.sha256((ROOT / "examples" / "quadruped.xml").read_bytes()).hexdigest()
    assert json.loads(spec.model_dump_json())["environment"]["options"]["model"] == f"sha256:{model}"
    assert model in (ROOT / "docs" / "tutorial.md").read_text()
