"""docs/settings.md, made from the settings' own classes.

`python -m gaitway.service.settings_page` prints it.
"""

import sys
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from pydantic import SecretStr
from pydantic.fields import FieldInfo

from core.configuration import PROCESSES, SECRETS_DIR
from core.variables import variable

_HEAD = """# Settings

All environment variables. `python -m gaitway.service.settings_page > docs/settings.md` makes this page
from the settings' own code.

A process reads its own settings once, when it starts. If one is missing or wrong, or a variable is nearly
the name of one, the process stops at once with exit status 78, and its log says which and why. (From a file
`.env`, Docker Compose passes on only the names that it knows: a misspelt one never arrives.) An empty
variable counts as unset. Durations are seconds (`90`, `0.5`) or ISO 8601 (`PT1M30S`); switches are `true` or
`false`.

"""

_SECRETS = """
Each of these may be a file instead: named like the variable in small letters (`gaitway_redis_url`), in the
folder that `GAITWAY_SECRETS_DIR` names. A variable wins over a file.
"""


@dataclass(frozen=True)
class OtherVariable:
    """A variable that no settings class has. readers: the programs that read it."""

    name: str
    readers: str
    default: str
    meaning: str


OTHERS = (
    OtherVariable(
        SECRETS_DIR, "API, worker, reconciler", "–", "Folder of files that hold settings, one each."
    ),
    OtherVariable(
        "GAITWAY_URL", "`gaitway`, `gaitway.Client`", "`http://127.0.0.1:8000`", "Address of the API."
    ),
    OtherVariable(
        "GAITWAY_TOKEN",
        "`gaitway`, `gaitway.Client`",
        "what `gaitway login` has stored",
        "The token for an API with accounts.",
    ),
    OtherVariable(
        "GAITWAY_ADDRESS",
        "Docker Compose",
        "`127.0.0.1`",
        "Address of this host that the API is published at.",
    ),
    OtherVariable(
        "GAITWAY_PORT", "Docker Compose", "`8000`", "Port of this host that the API is published at."
    ),
    OtherVariable(
        "GAITWAY_SHARE",
        "Docker Compose",
        "–",
        "Address of this host at which workers elsewhere reach its stores; with deploy/share.yml.",
    ),
    OtherVariable("GAITWAY_GPUS", "Docker Compose", "`all`", "How many GPUs the profile `gpu` takes."),
    OtherVariable(
        "GAITWAY_FLEET",
        "Docker Compose",
        "–",
        "Devices of the workers of the profile `gpu`, each for jobs of as many GPUs: `gpu:0,1 gpu:2`. By "
        "default jobs share out all GPUs.",
    ),
    OtherVariable("GAITWAY_WORKERS", "Docker Compose", "`1`", "How many workers share the CPU."),
    OtherVariable(
        "GAITWAY_STOP_WITHIN",
        "Docker Compose",
        "`2m`",
        "How long a worker may drain before it is killed; more than GAITWAY_GRACE.",
    ),
    OtherVariable("GAITWAY_IMAGE", "Docker Compose", "`gaitway`", "Prefix of the images' names."),
    OtherVariable("GAITWAY_TAG", "Docker Compose", "`latest`", "The images' tag."),
    OtherVariable(
        "MUJOCO_GL",
        "worker",
        "`egl`, else `osmesa`",
        "The OpenGL back-end that renders videos: `egl`, `osmesa` or `glfw`.",
    ),
    OtherVariable(
        "MUJOCO_EGL_DEVICE_ID",
        "worker",
        "the job's GPU",
        "The EGL device that renders, where EGL and CUDA number the GPUs differently.",
    ),
)


def page() -> str:
    """The whole page."""
    return _HEAD + "\n".join([*_table(_rows_of_settings()), _SECRETS, *_table(_rows_of_others())]) + "\n"


def _rows_of_settings() -> list[tuple[str, ...]]:
    readers: dict[str, list[str]] = {}
    fields: dict[str, FieldInfo] = {}
    for process, kind in PROCESSES.items():
        for name, field in kind.model_fields.items():
            readers.setdefault(name, []).append(process)
            fields[name] = field
    return [
        (f"`{variable(name)}`", ", ".join(readers[name]), _default(field), field.description or "")
        for name, field in fields.items()
    ]


def _rows_of_others() -> list[tuple[str, ...]]:
    return [(f"`{other.name}`", other.readers, other.default, other.meaning) for other in OTHERS]


def _table(rows: list[tuple[str, ...]]) -> list[str]:
    lines = [("variable", "read by", "default", "meaning"), ("---",) * 4, *rows]
    return ["| " + " | ".join(line) + " |" for line in lines]


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "**required**"
    return _text(field.default)


def _text(value: Any) -> str:
    match value:
        case None | "":
            return "–"
        case bool():
            return f"`{str(value).lower()}`"
        case timedelta():
            return f"`{value.total_seconds():.9g}` s"
        case SecretStr():
            return "secret"
        case _:
            return f"`{value}`"


if __name__ == "__main__":
    sys.stdout.write(page())
