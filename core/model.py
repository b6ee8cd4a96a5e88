"""The two attitudes to documents: strict towards what users send, lenient towards what we stored."""

from pydantic import BaseModel, ConfigDict


class Strict(BaseModel):
    """What a client sends: an unknown field is a typo, NaN is a mistake, `"3"` is not a number."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class Stored(BaseModel):
    """What we wrote ourselves, perhaps with an older or newer version: unknown fields are passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore")
