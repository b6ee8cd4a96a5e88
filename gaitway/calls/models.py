"""Users' own models."""

import time
from pathlib import Path
from urllib.parse import quote

from gaitway.calls.asking import POLL_S, Asking
from gaitway.errors import Rejected, WaitTimeout
from gaitway.steps import Call, Feed, Sleep
from gaitway.views import ModelView

# As the service allows.
_LONGEST_NAME = 100


class ModelCalls(Asking):
    """Calls about models."""

    def add_model(
        self, path: str | Path, timeout: float, name: str | None = None, main: str | None = None
    ) -> Call[ModelView]:
        body = Path(path).read_bytes()
        media_type = "application/zip" if body.startswith(b"PK") else "application/xml"
        deadline = time.monotonic() + timeout
        headers = {"Content-Type": media_type}
        said = {"name": _name_of(Path(path)) if name is None else name, "main": main}
        asked = {key: value for key, value in said.items() if value is not None}
        response = yield from self._ask("POST", "/models", content=body, headers=headers, params=asked)
        model = ModelView.model_validate_json(response.content)
        while model.status == "validating":
            if time.monotonic() > deadline:
                raise WaitTimeout(
                    f"No worker has read model {model.id} after {timeout:g} s; one that trains reads it"
                    " after its job. The service keeps it: `gaitway models show` tells when it is ready."
                )
            yield Sleep(POLL_S)
            model = yield from self.model(model.id)
        if model.status == "refused":
            raise Rejected(422, {"detail": model.message, "type": "/problems/bad-model"})
        return model

    def model(self, model_id: str) -> Call[ModelView]:
        response = yield from self._ask("GET", f"/models/{quote(model_id, safe=':')}")
        return ModelView.model_validate_json(response.content)

    def models(self, limit: int | None, name: str | None = None) -> Feed:
        return self._all("/models", ModelView, limit, {"name": name} if name is not None else None)

    def delete_model(self, model_id: str) -> Call[None]:
        yield from self._ask("DELETE", f"/models/{quote(model_id, safe=':')}")


def _name_of(path: Path) -> str | None:
    """The file's name as the service accepts it: without control characters, and not too long."""
    return "".join(sign for sign in path.name if sign.isprintable())[:_LONGEST_NAME] or None
