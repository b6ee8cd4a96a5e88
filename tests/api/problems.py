"""What the tests of refusals share."""

from typing import Any

import httpx


def problem(response: httpx.Response, status: int, code: str) -> dict[str, Any]:
    """The answer's document, once it has shown itself to be this problem."""
    assert response.status_code == status, response.text[:500]
    assert response.headers["content-type"] == "application/problem+json"
    document = response.json()
    assert document["type"] == f"/problems/{code}"
    assert document["status"] == status
    assert document["title"]
    assert document["detail"].endswith((".", "?"))
    assert document["instance"] == response.request.url.path
    return document


def pointers(document: dict[str, Any]) -> list[str]:
    return [place["pointer"] for place in document["errors"]]
