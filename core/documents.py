"""Base classes of documents: strict for what users send, lenient for what we stored."""

from typing import Any, Self

from pydantic import BaseModel, ConfigDict


class _Value(BaseModel):
    """Immutable, so it needs no copies: pydantic would otherwise copy a default at every use."""

    model_config = ConfigDict(frozen=True)

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Self:
        return self


class Strict(_Value):
    """A document from a client: an unknown field is a typo, NaN is a mistake, `"3"` is not a number."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class Stored(_Value):
    """A document of our own, perhaps of an older or newer version: unknown fields are ignored."""

    model_config = ConfigDict(extra="ignore")
