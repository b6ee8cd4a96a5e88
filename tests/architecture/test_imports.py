"""What loads what, shown in fresh processes; the layers by import-linter."""

import json
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]
NUMERICAL = {"av", "brax", "flax", "jax", "jaxlib", "mujoco", "numpy", "optax", "scipy"}


def modules_after(*modules: str) -> set[str]:
    """The top-level packages that a fresh interpreter holds after importing these."""
    code = (
        "import importlib, json, sys\n"
        f"for name in {modules!r}: importlib.import_module(name)\n"
        "print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", code], cwd="/", capture_output=True, text=True, check=True, timeout=60
    )
    return set(json.loads(done.stdout))


def names_below(package: str) -> list[str]:
    """Every module of a package, by its file."""
    files = (ROOT / package).rglob("*.py")
    dotted = (".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files)
    # Alembic runs the migrations; nobody imports them.
    names = (name for name in dotted if not name.endswith("__main__") and ".migrations." not in name)
    return sorted(name.removesuffix(".__init__") for name in names)


def specifications() -> list[str]:
    found = [*names_below("core/algorithms"), *names_below("core/environments")]
    return [name for name in found if name.rpartition(".")[2] in ("spec", "info", "catalog")]


@pytest.mark.parametrize(
    "modules",
    [
        ("api.app", "api.main"),
        ("worker.main",),
        ("worker.reconciler",),
        ("worker.supervision.supervisor", "worker.tasks"),
        tuple(specifications()),
        *(
            pytest.param(tuple(names_below(f"core/{name}")), marks=pytest.mark.extra)
            for name in ("jobs", "storage", "adapters")
        ),
    ],
    ids=lambda modules: modules[0],
)
def test_what_serves_and_what_forks_holds_no_numerical_stack(modules: tuple[str, ...]) -> None:
    assert modules_after(*modules) & NUMERICAL == set()


def test_the_client_needs_httpx_and_pydantic_alone() -> None:
    bare = modules_after("httpx", "pydantic")
    # The extras that httpx and pydantic bring along lazily count as theirs.
    theirs = {"annotated_types", "anyio", "certifi", "h11", "httpcore", "idna", "pydantic_core", "sniffio"}
    standard = set(sys.stdlib_module_names)
    private = {name for name in modules_after("gaitway", "gaitway.client") if name.startswith("_")}
    assert modules_after("gaitway", "gaitway.client") - bare - theirs - standard - private == {"gaitway"}


@pytest.mark.parametrize("module", ["worker.host.health", "gaitway.service.embedded.up"])
def test_what_is_waited_for_loads_neither_models_nor_clients(module: str) -> None:
    heavy = {"httpx", "minio", "psycopg", "pydantic", "redis", "rich", "sqlalchemy", "structlog"}
    assert modules_after(module) & heavy == set()


def test_the_layers_hold() -> None:
    linter = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([linter, "--no-cache"], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout
    assert re.search(r"Contracts: [1-9]\d* kept, 0 broken", done.stdout)


def test_no_import_circle() -> None:
    """Whichever module of a circle is imported first fails, and only there."""
    graph = grimp.build_graph(
        "api",
        "core",
        "gaitway",
        "mujoco_compiled",
        "worker",
        exclude_type_checking_imports=True,
        cache_dir=None,
    )
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    TopologicalSorter(imports).prepare()


def test_no_file_names_a_home_of_one_machine() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"], cwd=ROOT, capture_output=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    homes = re.compile(rb"(?<![\w.])/(?:home|Users|root|work)/[\w.-]+")
    names = [name.decode() for name in listed.stdout.split(b"\0") if name]
    # What others wrote may: Emscripten has a home in the file system that it keeps in memory.
    files = [ROOT / name for name in names if not name.startswith("api/pages/vendor/")]
    guilty = [
        str(file.relative_to(ROOT))
        for file in files
        if file.is_file() and file.suffix not in {".png", ".mp4", ".lock"} and homes.search(file.read_bytes())
    ]
    assert guilty == []
