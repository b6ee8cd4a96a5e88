"""An export of another service, brought to this one."""

import shutil
import tempfile
import uuid
import zlib
from functools import partial
from pathlib import Path
from zipfile import BadZipFile, ZipFile

from gaitway.calls.models import ModelCalls
from gaitway.steps import Call, Request, Run
from gaitway.views import JobView

# Far beyond what a service takes: what an export holds is not unpacked unseen.
_LARGEST_MODEL = 2**30


class ImportCalls(ModelCalls):
    """The call that imports a job."""

    def import_job(self, path: str | Path, idempotency_key: str | None, timeout: float) -> Call[JobView]:
        file = Path(path)
        with tempfile.TemporaryDirectory(prefix="gaitway-") as folder:
            for model in (yield Run(partial(_models_in, file, Path(folder)))):
                yield from self.add_model(model, timeout)
        headers = {
            "Content-Type": "application/zip",
            "Idempotency-Key": idempotency_key or uuid.uuid4().hex,
        }
        # The service answers once it has read all of the file and stored it.
        return (
            yield from self._job(
                Request("POST", "/jobs/import", file=file, headers=headers, read_timeout_s=timeout)
            )
        )


def _models_in(archive: Path, folder: Path) -> list[Path]:
    """The models in an export, unpacked into the folder; of what is no whole zip, the service says so."""
    try:
        with ZipFile(archive) as opened:
            infos = [
                info
                for info in opened.infolist()
                if info.filename.startswith("model/")
                and not info.is_dir()
                and info.file_size <= _LARGEST_MODEL
            ]
            models = [folder / f"model-{number}" for number in range(len(infos))]
            for info, model in zip(infos, models, strict=True):
                with opened.open(info) as source, model.open("wb") as target:
                    shutil.copyfileobj(source, target)
    except (BadZipFile, zlib.error, RuntimeError):  # Also of an unknown compression, or with a password.
        return []
    return models
