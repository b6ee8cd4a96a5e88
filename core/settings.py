"""Every setting of the service; a process reads them once, at its composition root."""

from datetime import timedelta
from pathlib import Path

from pydantic import Field, SecretStr
from pydantic_settings import BaseSettings, SettingsConfigDict


class Settings(BaseSettings):
    """Read from the environment, `GAITWAY_` before each name in capitals."""

    model_config = SettingsConfigDict(env_prefix="GAITWAY_", frozen=True)

    redis_url: SecretStr = Field(description="redis://, rediss:// or unix:// address, password included.")
    s3_endpoint: str = Field(description="host:port of the object store.")
    s3_access_key: str
    s3_secret_key: SecretStr
    s3_bucket: str = "gaitway"
    s3_secure: bool = Field(True, description="TLS to the object store.")
    s3_region: str | None = None
    data_dir: Path = Field(description="Spool, caches and locks of this machine's workers.")
    device: str = Field("auto", description="What a worker runs on: auto, cpu, or gpu:<index>.")
    lease: timedelta = Field(timedelta(seconds=15), description="How long a silent worker keeps its job.")
    heartbeat: timedelta = Field(
        timedelta(seconds=1), description="How often a worker renews it and looks for a cancel."
    )
    grace: timedelta = Field(timedelta(seconds=60), description="From a cancel, timeout or drain to SIGKILL.")
    reconcile_every: timedelta = Field(
        timedelta(seconds=5), description="Between two looks of the reconciler."
    )
    max_body_bytes: int = Field(2**20, description="Largest request body.")
