"""A Weights & Biases server of the smallest size: it accepts every run, and remembers what it was told."""

import base64
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from tests.faults.wandb_artifacts import WandbArtifacts


class WandbServer(ThreadingHTTPServer):
    """url: for GAITWAY_WANDB_BASE_URL. upserts: what runs were said to be; streams: what they sent;
    uploads: files by name; artifacts: what of these are artifacts; keys: with which one every request came.
    refused: the GraphQL operation that is answered with an error.
    """

    daemon_threads = True

    def __init__(self, status: int) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.status = status
        self.url = f"http://127.0.0.1:{self.server_port}"
        self.upserts: list[dict[str, Any]] = []
        self.streams: list[dict[str, Any]] = []
        self.uploads: dict[str, bytes] = {}
        self.artifacts = WandbArtifacts(self.url)
        self.keys = set[str]()
        self.refused: str | None = None

    def rows(self) -> list[dict[str, Any]]:
        """The history, in the order in which it came."""
        files = [stream.get("files", {}).get("wandb-history.jsonl", {}) for stream in self.streams]
        return [json.loads(line) for file in files for line in file.get("content", [])]


class _Handler(BaseHTTPRequestHandler):
    server: WandbServer

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        credentials = self.headers.get("Authorization", "").removeprefix("Basic ")
        self.server.keys.add(base64.b64decode(credentials).decode().removeprefix("api:"))
        if self.server.status != 200:
            self._answer({"errors": [{"message": "no"}]})
        elif self.path.endswith("/graphql"):
            self._answer(self._reply(json.loads(body)))
        else:
            self.server.streams.append(json.loads(body))
            self._answer({})

    def do_GET(self) -> None:
        self._answer({})

    def do_PUT(self) -> None:
        name = self.path.removeprefix("/upload/")
        self.server.uploads[name] = self.rfile.read(int(self.headers["Content-Length"]))
        self._answer({})

    def _reply(self, request: dict[str, Any]) -> dict[str, Any]:
        query, variables = request["query"], request.get("variables") or {}
        named = re.search(r"(?:mutation|query)\s+(\w+)", query)
        operation = named[1] if named else ""
        if operation == self.server.refused:
            return {"errors": [{"message": f"no {operation} here"}]}
        of_artifacts = self.server.artifacts.answer(operation, variables)
        return {"data": self._data(query, variables) if of_artifacts is None else of_artifacts}

    def _data(self, query: str, variables: dict[str, Any]) -> dict[str, Any]:
        if "upsertBucket" in query:
            self.server.upserts.append(variables)
            project = {"name": variables.get("project"), "entity": {"name": "me"}}
            bucket = {"id": "1", "name": variables.get("name"), "displayName": "", "project": project}
            return {"upsertBucket": {"bucket": bucket, "inserted": True}}
        if "createRunFiles" in query:
            files = [
                {"name": name, "uploadUrl": f"{self.server.url}/upload/{name}"} for name in variables["files"]
            ]
            return {"createRunFiles": {"runID": "1", "uploadHeaders": [], "files": files}}
        if "viewer {" in query:
            return {"viewer": {"id": "1", "username": "me", "entity": "me"}}
        return dict.fromkeys(re.findall(r"^\s{1,4}(\w+)", query, re.MULTILINE))

    def _answer(self, document: dict[str, Any]) -> None:
        body = json.dumps(document).encode()
        self.send_response(self.server.status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@contextmanager
def wandb_server(status: int = 200) -> Iterator[WandbServer]:
    """One that runs; status: of its every answer."""
    server = WandbServer(status)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
