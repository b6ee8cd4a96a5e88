"""docs/settings.md, made from the settings' own classes; `python -m core.settings_page` prints it."""

import sys
from datetime import timedelta
from typing import Any

from pydantic import SecretStr
from pydantic.fields import FieldInfo

from core.configuration import PROCESSES, variable
from core.other_variables import OTHERS

_HEAD = """# Settings

Every variable there is, made from `core/settings.py` by `python -m core.settings_page > docs/settings.md`.

A process reads its own settings once, when it starts. One that is missing or wrong, or a name that almost is
one, stops it at once with exit status 78 and a line in its log that says which and why. An empty variable is
an unset one. Durations are seconds (`90`, `0.5`) or ISO 8601 (`PT1M30S`); switches are `true` or `false`.

"""

_SECRETS = """
Each of these may be a file instead: named like the variable in small letters (`gaitway_redis_url`), in the
folder that `GAITWAY_SECRETS_DIR` names. A variable wins over a file.
"""


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
        case None:
            return "–"
        case bool():
            return f"`{str(value).lower()}`"
        case timedelta():
            return f"`{value.total_seconds():g}` s"
        case SecretStr():
            return "secret"
        case _:
            return f"`{value}`"


if __name__ == "__main__":
    sys.stdout.write(page())
