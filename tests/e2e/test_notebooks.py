"""Notebooks in a real kernel: a job that is shown live, and those of `examples/`."""

import base64
import threading
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell, new_notebook

from gaitway.client import Client
from tests.api.conftest import ARTIFACT, Attempt, Stack, job, quiet, server, stack

__all__ = ["quiet", "server", "stack"]  # fixtures

NOTEBOOKS = Path(__file__).parents[2] / "examples" / "notebooks"
# Two cores compile and train in it.
TIMEOUT_S = 500


def executed(notebook: Any, folder: Path, **hooks: Any) -> list[Any]:
    """The outputs of all cells; a cell that fails raises."""
    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=TIMEOUT_S, resources=resources, **hooks).execute()
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def html_of(outputs: list[Any]) -> str:
    return "".join(output["data"].get("text/html", "") for output in outputs if "data" in output)


@pytest.mark.extra
def test_a_job_is_shown_live_until_it_ends(
    stack: Stack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAITWAY_URL", f"http://127.0.0.1:{stack.port}")
    attempt = Attempt(stack, job(name="first steps"))

    def work() -> None:
        attempt.say("metrics", step=7, values={"eval/episode_reward": 2.5})
        attempt.keep("video.mp4")
        attempt.end()

    thread = threading.Thread(target=work)
    source = f"from gaitway import Client\nClient().get({attempt.id!r}).show(every_s=0)"
    outputs = executed(
        new_notebook(cells=[new_code_cell(source)]), tmp_path, on_cell_execute=lambda **_: thread.start()
    )
    thread.join()
    html = html_of(outputs)
    # One place for the job and one for its video, each with what came last alone.
    assert len(outputs) == 2
    assert html.count("succeeded") == 1
    assert html.count("data:video/mp4;base64,") == 1
    assert base64.b64encode(ARTIFACT).decode() in html
    assert html.count("return ▄ 2.5") == 1


def test_the_notebooks_of_the_examples_hold_what_came_out_of_them() -> None:
    found = sorted(path.name for path in NOTEBOOKS.glob("*.ipynb"))
    assert found == ["corridor.ipynb", "imitation.ipynb", "rodent.ipynb", "star.ipynb"]
    for name in found:
        path = NOTEBOOKS / name
        notebook = nbformat.read(path, as_version=4)
        outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
        assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
        assert not any(output.output_type == "error" for output in outputs)
        assert "data:video/mp4;base64," in html_of(outputs)
        assert "http://" not in path.read_text(), "an address of the machine that ran it"
        assert path.stat().st_size < 300_000


@pytest.mark.slow
@pytest.mark.timeout(TIMEOUT_S)
@pytest.mark.parametrize("name", ["star", "rodent", "corridor", "imitation"])
def test_a_notebook_runs_from_top_to_bottom(
    name: str, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAITWAY_URL", client.base_url)
    outputs = executed(nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4), tmp_path)
    assert "data:video/mp4;base64," in html_of(outputs)
    assert all(found.succeeded for found in client.list())
