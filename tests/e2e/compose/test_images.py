"""What the images are: small, quick to make anew, without root and without secrets."""

import json
import time
from pathlib import Path

from tests.e2e.compose.conftest import Figure
from tests.e2e.compose.project import BASE, Project, run, size_mb


def test_the_images_are_small(images: str, report: list[Figure]) -> None:
    base = size_mb(BASE)
    sizes = {name: size_mb(f"gaitway-{name}:{images}") - base for name in ("api", "worker")}
    report += [
        Figure("api image, over its base", sizes["api"], "MB", 200),
        Figure("worker image, over its base", sizes["worker"], "MB", 1500),
    ]
    assert sizes["api"] <= 200
    assert sizes["worker"] <= 1500


def test_a_change_of_one_file_is_built_in_seconds(checkout: Path, images: str, report: list[Figure]) -> None:
    project = Project(checkout, {"GAITWAY_TAG": f"{images}-changed"})
    with (checkout / "api" / "app.py").open("a") as file:
        file.write(f"\n# {project.name}\n")
    started = time.monotonic()
    try:
        project.compose("build")
    finally:
        run("docker", "image", "rm", *(f"gaitway-{name}:{images}-changed" for name in ("api", "worker")))
    taken = time.monotonic() - started
    report.append(Figure("rebuild after a change of one Python file", taken, "s", 20))
    assert taken <= 20


def test_the_images_need_no_root_and_say_what_they_are(images: str) -> None:
    for name in ("api", "worker"):
        described = json.loads(run("docker", "image", "inspect", f"gaitway-{name}:{images}"))[0]["Config"]
        assert described["User"] == "gaitway"
        assert described["Entrypoint"] == ["tini", "--"]
        assert described["Healthcheck"]["Test"]
        assert described["Labels"]["org.opencontainers.image.licenses"] == "Apache-2.0"


def test_the_api_image_holds_no_numerical_stack(images: str) -> None:
    look = (
        "import importlib.util as u; print([n for n in ('jax', 'mujoco', 'numpy', 'av') if u.find_spec(n)])"
    )
    found = run("docker", "run", "--rm", f"gaitway-api:{images}", "python", "-c", look)
    assert found.strip() == "[]"


def test_the_worker_draws_in_software(images: str) -> None:
    command = ("python", "-c", "from core.rendering.gl import probe; print(*probe())")
    drawn = run(
        "docker", "run", "--rm", "--read-only", "--tmpfs", "/tmp", f"gaitway-worker:{images}", *command
    )
    assert drawn.startswith("egl llvmpipe")
