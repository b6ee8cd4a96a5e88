"""The two attitudes to documents: strict towards what users send, lenient towards what we stored."""

from typing import Any, Self

from pydantic import BaseModel, ConfigDict


class _Value(BaseModel):
    """Nobody changes one, so nobody needs a copy: pydantic would make one of a default at every use."""

    model_config = ConfigDict(frozen=True)

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Self:
        return self


class Strict(_Value):
    """What a client sends: an unknown field is a typo, NaN is a mistake, `"3"` is not a number."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class Stored(_Value):
    """What we wrote ourselves, perhaps with an older or newer version: unknown fields are passed over."""

    model_config = ConfigDict(extra="ignore")
