"""Users' own models and clips, stills of bodies, environments, and the service itself."""

import io
import json
import time
import zipfile
from collections.abc import AsyncIterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx

from gaitway.addresses import POLL_S
from gaitway.async_client.connection import AsyncConnection
from gaitway.concurrency import async_sleep
from gaitway.errors import Rejected, WaitTimeout
from gaitway.schema import (
    ClipFileView,
    EnvironmentDetails,
    ModelView,
    PreviewView,
    SlotsView,
    UsageView,
    WorkerView,
)

# As the service allows.
_LONGEST_NAME = 100


def _name_of(file: Path) -> str | None:
    """The service takes no control characters, and only so many others."""
    return "".join(sign for sign in file.name if sign.isprintable())[:_LONGEST_NAME] or None


def _with_points(file: Path, points: str | Path | Mapping[str, Any]) -> bytes:
    """A ZIP of both, with equal bytes for equal content."""
    said = json.dumps(points).encode() if isinstance(points, Mapping) else Path(points).read_bytes()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as both:
        both.writestr(zipfile.ZipInfo("points.json"), said)
        both.writestr(zipfile.ZipInfo(f"recording{file.suffix}"), file.read_bytes())
    return packed.getvalue()


class AsyncCatalog(AsyncConnection):
    """The methods about what jobs may name, and about the service."""

    async def add_model(
        self,
        path: str | Path,
        timeout: float = 120.0,
        *,
        name: str | None = None,
        main: str | None = None,
        project: str | None = None,
    ) -> ModelView:
        """Send a model (MJCF, URDF, or a zip of it and its meshes), and wait until it is validated.

        The same file is the same model; the name is the last one that it was sent by. name: by default the
        file's. main: the document of a zip that is the model, where it has several. project: whose members
        may use it. Raises Rejected where it cannot be used, and WaitTimeout after `timeout` seconds without a
        worker that validates it.
        """
        file = Path(path)
        body = file.read_bytes()
        deadline = time.monotonic() + timeout
        headers = {"Content-Type": "application/zip" if body.startswith(b"PK") else "application/xml"}
        params = {
            key: value
            for key, value in (("name", name or _name_of(file)), ("main", main), ("project", project))
            if value is not None
        }
        model = await self._post("/models", ModelView, content=body, headers=headers, params=params)
        while model.status == "validating":
            if time.monotonic() > deadline:
                raise WaitTimeout(
                    f"No worker has read model {model.id} after {timeout:g} s; one that trains reads it"
                    " after its job. The service keeps it: `gaitway models show` tells when it is ready."
                )
            await async_sleep(POLL_S)
            model = await self.model(model.id)
        if model.status == "refused":
            raise Rejected(422, {"detail": model.message, "type": "/problems/bad-model"})
        return model

    async def model(self, model_id: str) -> ModelView:
        """A model with its contents."""
        return await self._get(f"/models/{quote(model_id, safe=':')}", ModelView)

    def models(self, *, limit: int | None = None, name: str | None = None) -> AsyncIterator[ModelView]:
        """Models, the last sent first, fetched page by page as needed; at most `limit`.

        name: only those of this name.
        """
        return self._all("/models", ModelView, limit, {"name": name} if name is not None else {})

    async def delete_model(self, model_id: str) -> None:
        """Remove a model. Raises Conflict while an unfinished job needs it."""
        await self._request("DELETE", f"/models/{quote(model_id, safe=':')}")

    async def add_clips(  # noqa: PLR0913 # How the file is to be read.
        self,
        path: str | Path,
        body: str,
        timeout: float = 120.0,
        *,
        rate: float | None = None,
        points: str | Path | Mapping[str, Any] | None = None,
        name: str | None = None,
        project: str | None = None,
    ) -> ClipFileView:
        """Send a file of clips, recordings of a body's motion, and wait until it is validated.

        body: whose they are, an environment such as `g1`, or a model of your own by its id. rate: frames per
        second, for a file that does not say. points: which points of the body the key points of the file are,
        a JSON file or its content (docs/imitation.md). name, project, timeout, Raises: as for `add_model`.
        """
        file, deadline = Path(path), time.monotonic() + timeout
        params = {"name": name or _name_of(file), "body": body, "rate": rate, "project": project}
        params = {key: value for key, value in params.items() if value is not None}
        headers = {"Content-Type": "application/octet-stream"}
        content = file.read_bytes() if points is None else _with_points(file, points)
        clips = await self._post("/clips", ClipFileView, content=content, headers=headers, params=params)
        while clips.status == "validating":
            if time.monotonic() > deadline:
                raise WaitTimeout(
                    f"No worker has read the clips {clips.id} after {timeout:g} s"
                    + (f" ({clips.message[:-1]})" if clips.message else "")
                    + "; one that trains reads them after its job, and key points take minutes. The service "
                    "keeps them: `gaitway clips show` tells when they are ready."
                )
            await async_sleep(POLL_S)
            clips = await self.clip_file(clips.id)
        if clips.status == "refused":
            raise Rejected(422, {"detail": clips.message, "type": "/problems/bad-clips"})
        return clips

    async def clip_file(self, clips_id: str) -> ClipFileView:
        """A file of clips with what is in it."""
        return await self._get(f"/clips/{quote(clips_id, safe=':')}", ClipFileView)

    def clip_files(self, *, limit: int | None = None, name: str | None = None) -> AsyncIterator[ClipFileView]:
        """Files of clips, the last sent first, fetched page by page as needed; at most `limit`.

        name: only those of this name.
        """
        return self._all("/clips", ClipFileView, limit, {"name": name} if name is not None else {})

    async def rename_clips(self, clips_id: str, name: str) -> ClipFileView:
        """Give a file of clips another name. Raises Rejected where others have it, too."""
        path = f"/clips/{quote(clips_id, safe=':')}"
        headers = {"Content-Type": "application/merge-patch+json"}
        answer = await self._request("PATCH", path, content=json.dumps({"name": name}), headers=headers)
        return ClipFileView.model_validate_json(answer.content)

    async def clips_content(self, clips_id: str) -> bytes:
        """The file as it was sent."""
        return (await self._request("GET", f"/clips/{quote(clips_id, safe=':')}/file")).content

    async def delete_clips(self, clips_id: str) -> None:
        """Remove a file of clips. Raises Conflict while an unfinished job needs it."""
        await self._request("DELETE", f"/clips/{quote(clips_id, safe=':')}")

    async def preview(  # noqa: PLR0913 # A request's options.
        self,
        environment: str,
        folder: str | Path | None = None,
        *,
        options: Mapping[str, Any] | None = None,
        camera: str | int | None = None,
        show: Sequence[str] = (),
        size: tuple[int, int] = (640, 480),
        timeout: float = 120.0,
    ) -> Mapping[str | int, Path]:
        """The environment as an episode begins: a PNG in `folder` (by default here) from each camera.

        camera: only this one. show: what is drawn besides the body, as in a job's `video.show`. size: width
        and height in pixels. Raises Rejected for an unknown option or camera, and WaitTimeout after `timeout`
        seconds without a worker that renders it.
        """
        query: dict[str, Any] = {"options": json.dumps(options or {}), "show": [*show]}
        query |= {"width": size[0], "height": size[1]}
        bodies: dict[str | int, bytes] = {}
        if camera is None:
            drawn = await self._drawn(environment, query, timeout)
            for still in PreviewView.model_validate_json(drawn.content).stills:
                bodies[still.camera] = (await self._request("GET", still.href)).content
        else:
            bodies[camera] = (await self._drawn(environment, {**query, "camera": camera}, timeout)).content
        target = Path(folder or ".")
        target.mkdir(parents=True, exist_ok=True)
        pictures = {seen: target / f"{environment}-{seen}.png".replace("/", "-") for seen in bodies}
        for seen, file in pictures.items():
            file.write_bytes(bodies[seen])
        return pictures

    async def _drawn(self, environment: str, query: Mapping[str, Any], timeout: float) -> httpx.Response:
        """The answer once a worker has rendered."""
        deadline, path = time.monotonic() + timeout, f"/environments/{quote(environment)}/preview"
        while (answer := await self._request("GET", path, params=query)).status_code == 202:
            if time.monotonic() > deadline:
                raise WaitTimeout(
                    f"No worker has rendered it after {timeout:g} s; all may be busy with jobs."
                )
            await async_sleep(POLL_S)
        return answer

    async def environments(self, family: str | None = None) -> Sequence[EnvironmentDetails]:
        """The environments that a job may name. family: only `gaitway`, `playground` or `brax`."""
        return await self._items(
            "/environments", EnvironmentDetails, params={"family": family} if family else {}
        )

    async def environment(
        self, environment: str, options: Mapping[str, Any] | None = None
    ) -> EnvironmentDetails:
        """One environment under these options: what it is shown and does, and what a job gets by default.

        Raises Rejected for an unknown option.
        """
        params = {"options": json.dumps(options)} if options else {}
        return await self._get(f"/environments/{quote(environment)}", EnvironmentDetails, params=params)

    def workers(self, *, limit: int | None = None) -> AsyncIterator[WorkerView]:
        """The workers that have sent a heartbeat lately, by name; at most `limit`."""
        return self._all("/workers", WorkerView, limit, {})

    async def slots(self, *, counted_as: str | None = None) -> SlotsView:
        """How many workers the queue wants, by kind. counted_as: `cpu` or `gpu`, where jobs count that ask
        for no particular device; otherwise they are of the kind `any`."""
        params = {} if counted_as is None else {"counted_as": counted_as}
        return await self._get("/slots", SlotsView, params=params)

    async def usage(self, since: datetime | None = None) -> UsageView:
        """What was used since then, by default in the last day, by project and user; and by device.

        since: rounded down to the hour; without a time zone, it is local time.
        """
        params = {} if since is None else {"since": since.astimezone().isoformat()}
        return await self._get("/usage", UsageView, params=params)

    async def health(self) -> Mapping[str, Any]:
        """The service's readiness. Raises Unavailable when a part of it is unavailable."""
        return (await self._request("GET", "/readyz")).json()
