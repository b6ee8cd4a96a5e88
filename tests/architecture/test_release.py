"""The files that name the version name the same one."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_version_of_the_package_is_in_the_changelog_and_in_the_citation() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\n## [{version}] - " in (ROOT / "CHANGELOG.md").read_text()
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
