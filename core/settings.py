"""Every setting of the service; a process reads its own once, at its composition root.

StoreSettings            what every process needs: where the record, the queue and the objects are
├── ApiSettings
├── WorkerSettings       one worker; `worker.fleet` passes them on, with one device each
└── ReconcilerSettings
"""

import json
import ssl
from datetime import timedelta
from ipaddress import IPv4Network, IPv6Network, ip_address, ip_network
from pathlib import Path
from typing import Annotated, Any, Literal, Self
from urllib.parse import quote, urlsplit

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ByteSize,
    ConfigDict,
    Field,
    SecretStr,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from core.bounds import ACCOUNT_NAME
from core.devices import GPUS, num_cores
from core.variables import PREFIX

_REDIS_SCHEMES = ("redis", "rediss", "unix")


def _number_of_seconds(value: Any) -> Any:
    """A bare number is seconds; pydantic itself would require an ISO 8601 duration."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


def _address(value: str) -> str:
    if "/" in value:
        raise ValueError("write host:port alone; GAITWAY_S3_SECURE says whether it is https")
    return value


def _redis_address(value: SecretStr) -> SecretStr:
    try:
        scheme = urlsplit(value.get_secret_value()).scheme
    except ValueError:  # Its message may contain a part of the password.
        raise ValueError(
            "it is not an address; percent-encode characters like @ / : [ ] % # in the password"
        ) from None
    if scheme not in _REDIS_SCHEMES:
        raise ValueError("begin it with redis://, rediss:// (TLS) or unix://")
    return value


def _database_address(value: SecretStr) -> SecretStr:
    if not value.get_secret_value().startswith(("postgresql://", "postgres://")):
        raise ValueError("begin it with postgresql://")
    return value


def _networks(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    try:
        return tuple(ip_network(part.strip()) for part in value.split(",") if part.strip())
    except ValueError as error:
        raise ValueError(f"write networks like 10.1.0.0/16, separated by commas ({error})") from None


def _authorities(value: Path) -> Path:
    try:
        ssl.create_default_context(cafile=value)
    except OSError as error:
        raise ValueError(
            f"{value} cannot be read as certificates in PEM ({error.strerror or error}); let every user "
            "read it (chmod 644)"
        ) from None
    return value


# At most a year, so that adding several to a time cannot overflow.
Seconds = Annotated[
    timedelta, BeforeValidator(_number_of_seconds), Field(gt=timedelta(0), le=timedelta(days=365))
]
Address = Annotated[str, Field(min_length=1), AfterValidator(_address)]
RedisAddress = Annotated[SecretStr, AfterValidator(_redis_address)]
DatabaseAddress = Annotated[SecretStr, AfterValidator(_database_address)]
Authorities = Annotated[Path, AfterValidator(_authorities)]
Networks = tuple[IPv4Network | IPv6Network, ...]
NewsNetworks = Annotated[
    Networks,
    NoDecode,
    BeforeValidator(_networks),
    Field(
        description="Private networks to which webhooks may send, separated by commas, such as "
        "`10.1.0.0/16,127.0.0.1/32`. Public addresses are always allowed. Set it for API and reconciler."
    ),
]
AliveFile = Annotated[
    Path | None,
    Field(
        description="File that the process touches as long as it is alive, for a container's health check; a "
        "fleet's workers add .0, .1, … to the name."
    ),
]
Confinement = Literal["confined", "unconfined"]
Lease = Annotated[Seconds, Field(description="How long a silent worker keeps its job.")]


WorkerDatabase = Annotated[
    DatabaseAddress | None,
    Field(
        description="GAITWAY_DATABASE_URL for workers that join by a token, as other machines reach it, with "
        "a user of its own: the reconciler gives that user rights on the tables of jobs alone."
    ),
]


def _json(value: Any) -> Any:
    try:
        return json.loads(value) if isinstance(value, str) else value
    except ValueError as error:
        raise ValueError(f"write it as JSON ({error})") from None


def is_safe_address(address: str) -> bool:
    """Whether nobody between can read along: over TLS, or on this very machine."""
    try:
        parts = urlsplit(address)
    except ValueError:
        return False
    is_here = parts.hostname in ("127.0.0.1", "localhost", "::1")
    return bool(parts.hostname) and (parts.scheme == "https" or (parts.scheme == "http" and is_here))


class GroupGrant(BaseModel):
    """The role and projects that members of one of the identity provider's groups get."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    role: Literal["viewer", "submitter", "admin"] = "submitter"
    projects: frozenset[Annotated[str, Field(pattern=f"^{ACCOUNT_NAME}$")]] = frozenset()


class StoreSettings(BaseSettings):
    """Read from the environment: `GAITWAY_` and the name in capitals; an empty variable counts as unset.

    A value may also be a file with the variable's name in lower case, in the folder GAITWAY_SECRETS_DIR.
    """

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, env_ignore_empty=True, frozen=True, hide_input_in_errors=True, extra="ignore"
    )

    # Before the addresses: their validator adds it to them.
    tls_ca: Authorities | None = Field(
        None,
        description="PEM file with the certificate of the authority that signed the stores' certificates, "
        "unless the system knows it; TLS to PostgreSQL always needs it.",
    )
    database_url: DatabaseAddress = Field(
        description="Address of PostgreSQL: postgresql://USER:PASSWORD@HOST:PORT/DATABASE; for TLS with "
        "?sslmode=verify-full at its end."
    )
    redis_url: RedisAddress = Field(
        description="Address of Redis or Valkey: redis://:PASSWORD@HOST:PORT/0, rediss:// for TLS, or "
        "unix:///path/to/its.sock."
    )
    redis_without_password: bool = Field(
        False, description="Accept a Redis on another machine that asks for no password."
    )
    s3_endpoint: Address = Field(description="Address of the object store: HOST:PORT, without https://.")
    s3_access_key: str = Field(min_length=1, description="Id of the object store's access key.")
    s3_secret_key: SecretStr = Field(min_length=1, description="Secret of the access key.")
    s3_bucket: str = Field("gaitway", min_length=3, max_length=63, description="The bucket; it must exist.")
    s3_secure: bool = Field(True, description="Use TLS to the object store.")
    s3_region: str | None = Field(None, description="The bucket's region, where the store has regions.")
    s3_style: Literal["auto", "path", "host"] = Field(
        "auto",
        description="How the bucket is addressed: HOST/BUCKET (path), BUCKET.HOST (host), or host for "
        "Amazon's own addresses and path for all others (auto).",
    )

    @field_validator("database_url", "redis_url")
    @classmethod
    def _trusts_the_authority(cls, value: SecretStr, info: ValidationInfo) -> SecretStr:
        """The clients of PostgreSQL and Redis take the authority's file from the address."""
        url, file = value.get_secret_value(), info.data.get("tls_ca")
        parameter = "sslrootcert" if info.field_name == "database_url" else "ssl_ca_certs"
        speaks_tls = url.startswith(("postgres", "rediss:"))
        if file is None or not speaks_tls or f"{parameter}=" in url:
            return value
        return SecretStr(f"{url}{'&' if '?' in url else '?'}{parameter}={quote(str(file))}")

    @model_validator(mode="after")
    def _no_open_door(self) -> Self:
        if not self.redis_without_password and _is_open(self.redis_url.get_secret_value()):
            raise ValueError(
                f"{PREFIX}REDIS_URL names another machine and has no password: anyone who reaches that "
                "Redis decides what the workers run. Give it one (requirepass) and write "
                f"redis://:PASSWORD@HOST:PORT/0, or accept it by {PREFIX}REDIS_WITHOUT_PASSWORD=true."
            )
        return self


class ApiSettings(StoreSettings):
    """The settings of `python -m api`."""

    max_body_bytes: int = Field(2**20, gt=0, description="Largest request body, in bytes.")
    max_model_bytes: int = Field(
        2**26, gt=0, description="Largest model that `POST /models` accepts, in bytes as it is sent."
    )
    max_clips_bytes: int = Field(
        2**28, gt=0, description="Largest file that `POST /clips` accepts, in bytes."
    )
    max_waiting_models: int = Field(
        32,
        gt=0,
        description="How many models, and how many files of clips, may wait for validation; further ones are "
        "refused.",
    )
    max_import_bytes: int = Field(
        2**32,
        gt=0,
        description="Largest export that `POST /jobs/import` accepts, in bytes, as it is sent and as it is "
        "unpacked. It waits in the API's temporary folder (`TMPDIR`), at most two at a time in each process.",
    )
    api_processes: int = Field(
        0,
        ge=0,
        le=64,
        description="How many processes answer requests; each takes at most one core and 125 MB. 0 means one "
        "for every four cores of the machine, and at most four.",
    )
    published: str | None = Field(
        None,
        description="The host address at which others reach the API, where it cannot know this: behind a "
        "proxy, or published by a container engine. Without accounts, the API starts only if this is an "
        "address of this machine alone.",
    )
    accounts: bool = Field(
        False,
        description="Whether users have accounts: each request then needs a token. Without them the API "
        "answers on this machine alone, and everybody there may do everything.",
    )
    requests_per_second: float = Field(
        500.0,
        gt=0,
        description="How many requests a second one user may make in each process, with all tokens together, "
        "on average over ten seconds; further ones are answered 429, with the time to wait.",
    )
    news_networks: NewsNetworks = ()
    worker_database_url: WorkerDatabase = None
    worker_redis_url: RedisAddress | None = Field(
        None,
        description="GAITWAY_REDIS_URL as workers on other machines reach it, for `GET /workers/settings`; "
        "by default the same.",
    )
    worker_s3_secure: bool | None = Field(
        None,
        description="Whether these workers use TLS to the object store; by default as GAITWAY_S3_SECURE.",
    )
    worker_s3_access_key: str | None = Field(
        None,
        min_length=1,
        description="Id of an access key for these workers alone, which may read and write the bucket; by "
        "default they get GAITWAY_S3_ACCESS_KEY, with its secret.",
    )
    worker_s3_secret_key: SecretStr | None = Field(
        None, min_length=1, description="Secret of GAITWAY_WORKER_S3_ACCESS_KEY."
    )
    worker_tls_ca: Authorities | None = Field(
        None, description="GAITWAY_TLS_CA for these workers; by default the same."
    )
    worker_s3_endpoint: Address | None = Field(
        None,
        description="GAITWAY_S3_ENDPOINT as workers on other machines reach it, for `GET /workers/settings`; "
        "by default the same.",
    )
    session_idle: Seconds = Field(
        timedelta(days=3), description="Who has not used the page for this long signs in again."
    )
    session_lifetime: Seconds = Field(
        timedelta(days=30), description="Who signed in on the page this long ago signs in again."
    )
    sign_ins_per_minute: float = Field(
        20.0,
        gt=0,
        description="How many sign-ins on the page may fail in a minute from one address, in each process; "
        "further ones are answered 429.",
    )
    oidc_issuer: str | None = Field(
        None,
        description="Where users sign in on the page (OpenID Connect): the identity provider's issuer as it "
        "calls itself, https://…; docs/teams.md has those of Keycloak, Google, Dex and Microsoft Entra.",
    )
    oidc_client_id: str | None = Field(None, min_length=1, description="This service's id at the provider.")
    oidc_client_secret: SecretStr | None = Field(
        None, min_length=1, description="The secret that belongs to the id; a public client has none."
    )
    oidc_name: str = Field(
        "single sign-on", min_length=1, max_length=60, description="What the page calls the provider."
    )
    oidc_scopes: str = Field(
        "openid profile email", pattern=r"^openid( |$)", description="What is asked of the provider."
    )
    oidc_user_claim: str = Field(
        "preferred_username",
        min_length=1,
        description="The claim that names the user, such as `email`. People must not be able to choose it.",
    )
    oidc_domains: str = Field(
        "",
        description="Domains of the addresses that may sign in, separated by commas; `*` lets in everybody "
        "whom the provider knows. Needed, unless GAITWAY_OIDC_GROUPS says who may.",
    )
    oidc_emails_are_verified: bool = Field(
        False,
        description="Whether the provider checks all addresses itself and leaves `email_verified` out. "
        "Without this, an address of which the provider does not say so lets nobody in.",
    )
    oidc_groups: Annotated[dict[str, GroupGrant], NoDecode, BeforeValidator(_json)] = Field(
        {},
        description="Groups that may sign in, with the role and the projects that they give, as JSON: "
        '`{"legs": {"role": "submitter", "projects": ["gaits"]}, "legs-admins": {"role": "admin"}}`. Each '
        "sign-in gives these again.",
    )
    oidc_groups_claim: str = Field("groups", min_length=1, description="The claim that lists the groups.")
    oidc_role: Literal["viewer", "submitter", "admin"] = Field(
        "submitter", description="The role of a user who signs in for the first time, without groups."
    )
    oidc_projects: str = Field(
        "default",
        pattern=f"^({ACCOUNT_NAME}(, *{ACCOUNT_NAME})*)?$",
        description="Projects that a new user enters, separated by commas; made if they are missing.",
    )
    allowed_hosts: str = Field(
        "",
        description="Names of the API besides localhost and numeric addresses, separated by commas. Requests "
        "that name another host are refused; pages of these hosts may use the API.",
    )

    @model_validator(mode="after")
    def _has_both_parts_of_the_workers_key(self) -> Self:
        if (self.worker_s3_access_key is None) != (self.worker_s3_secret_key is None):
            raise ValueError(f"{PREFIX}WORKER_S3_ACCESS_KEY and {PREFIX}WORKER_S3_SECRET_KEY go together.")
        return self

    @model_validator(mode="after")
    def _knows_whom_to_let_in(self) -> Self:
        if self.oidc_issuer is None:
            return self
        if not is_safe_address(self.oidc_issuer):
            raise ValueError(f"{PREFIX}OIDC_ISSUER begins with https://.")
        if self.oidc_client_id is None:
            raise ValueError(f"{PREFIX}OIDC_ISSUER needs {PREFIX}OIDC_CLIENT_ID.")
        if not self.accounts:
            raise ValueError(f"{PREFIX}OIDC_ISSUER needs {PREFIX}ACCOUNTS=true.")
        if not self.oidc_groups and not self.oidc_domains.strip():
            raise ValueError(
                f"{PREFIX}OIDC_ISSUER needs {PREFIX}OIDC_DOMAINS or {PREFIX}OIDC_GROUPS, which say who "
                f"may sign in; {PREFIX}OIDC_DOMAINS=* lets in everybody whom the provider knows."
            )
        return self

    @property
    def num_processes(self) -> int:
        return self.api_processes or min(4, max(1, num_cores() // 4))

    @property
    def hosts(self) -> frozenset[str]:
        """The allowed names, and the published one."""
        named = [*self.allowed_hosts.split(","), self.published or ""]
        return frozenset(name.strip().lower() for name in named) - {""}


class WorkerSettings(StoreSettings):
    """The settings of `python -m worker.main`."""

    data_dir: Path = Field(description="Folder of this machine's spool, caches and locks.")
    device: str = Field(
        "auto",
        pattern=rf"^(auto|cpu|{GPUS})$",
        description="What the worker runs on: cpu, gpu:INDEX, or auto for the first GPU if there is one and "
        "JAX can use it. With several GPUs (gpu:0,1 or gpu:0-3) it takes the jobs that ask for this many.",
    )
    pool: str | None = Field(
        None,
        pattern=rf"^{GPUS}$",
        description="The GPUs of this machine that jobs of 1, 2, 4 and more GPUs share out, e.g. gpu:0-7. "
        "`worker.fleet` passes it on to its workers; by default all GPUs.",
    )
    seats: int = Field(
        2,
        ge=1,
        le=8,
        description="How many jobs may share a GPU, of those that ask for it; `worker.fleet` starts as many "
        "workers for each GPU.",
    )
    seat: int = Field(
        0,
        ge=0,
        lt=8,
        description="Which of the workers of its GPU this one is, from 0. `worker.fleet` sets it.",
    )
    hosts: int = Field(
        1,
        ge=1,
        le=64,
        description="How many machines take a job together: each has a worker with this number, and they "
        "take the jobs that ask for as many `hosts`.",
    )
    host_rank: int | None = Field(
        None,
        ge=0,
        description="Which of these machines this is, from 0; under Slurm's srun, its SLURM_PROCID.",
    )
    coordinator: str | None = Field(
        None,
        pattern=r"^\S+:\d{1,5}$",
        description="HOST:PORT at which the worker of machine 0 listens for those of the others; under "
        "Slurm's srun, the first node and a port by the job's number.",
    )
    gang_secret: SecretStr | None = Field(
        None,
        min_length=16,
        description="Secret by which the workers of several machines know each other; by default the object "
        "store's secret key, if all of them have the same.",
    )
    alive_file: AliveFile = None
    # The reconciler looks every second, so a lost worker is noticed within 15 s.
    lease: Lease = timedelta(seconds=14)
    heartbeat: Seconds = Field(
        timedelta(seconds=1), description="How often a worker renews its lease and checks for a cancel."
    )
    grace: Seconds = Field(
        timedelta(seconds=60), description="Time from a cancel, timeout or drain to SIGKILL."
    )
    idle_exit: Seconds | None = Field(
        None,
        description="A worker that has had no job for this long ends by itself; unset, it waits for ever.",
    )
    ends_at: AwareDatetime | None = Field(
        None,
        description="When the worker's machine is taken away, in seconds since 1970 or as RFC 3339: it "
        "drains GAITWAY_GRACE and 15 s before. Slurm's workers take it from Slurm.",
    )
    start_margin: Seconds = Field(
        timedelta(seconds=120),
        description="Time from the start of a job to its first checkpoint: with less left before "
        "GAITWAY_ENDS_AT, a worker takes no further job and ends.",
    )
    stall: Seconds = Field(
        timedelta(minutes=10),
        description="A training that says nothing for this long, and for twenty times its longest silence so "
        "far, counts as hung: it is ended and tried again.",
    )
    cache_max_bytes: int = Field(
        2**31,
        ge=0,
        description="Size of the compilation cache in GAITWAY_DATA_DIR, in bytes; the least recently used "
        "entries are removed first.",
    )
    shared_cache_max_bytes: int = Field(
        2**31,
        ge=0,
        description="Size of the compilation cache in the object store, shared with other machines, in "
        "bytes; the oldest entries are removed first. 0 shares nothing and takes nothing. Use the same value "
        "for all workers of a bucket.",
    )
    memory_limit: ByteSize | None = Field(
        None,
        ge=2**28,
        description="How much of this machine's memory a training may take before it is ended, e.g. 8GiB; "
        "by default that of the machine or container, less 5 % (at least 0.5 GiB).",
    )
    prepare: str = Field(
        "",
        description="Environments, separated by commas, whose default training a worker without a job "
        "compiles, once, so that the first such job starts as fast as the next. `gaitway up` and Docker "
        "Compose say ant where this is not set; empty: none.",
    )
    models: Confinement = Field(
        "confined",
        description="confined: a user's model is refused where the system cannot confine the process that "
        "reads it; unconfined: models are read with what confinement the system has, and previews and "
        "trainings may read the worker's files.",
    )
    wandb_api_key: SecretStr | None = Field(
        None, min_length=1, description="Key for Weights & Biases, for jobs that ask for tracking there."
    )
    wandb_base_url: str | None = Field(
        None, pattern=r"^https?://", description="A Weights & Biases server of your own: https://HOST."
    )

    @property
    def prepared(self) -> tuple[str, ...]:
        """The environments that `prepare` names."""
        return tuple(filter(None, map(str.strip, self.prepare.split(","))))

    @model_validator(mode="after")
    def _outlives_a_missed_beat(self) -> Self:
        if self.lease < 3 * self.heartbeat:
            raise ValueError(
                f"{PREFIX}LEASE ({self.lease.total_seconds():g} s) has to be at least three times "
                f"{PREFIX}HEARTBEAT ({self.heartbeat.total_seconds():g} s), or a short delay costs a job."
            )
        return self


class ReconcilerSettings(StoreSettings):
    """The settings of `python -m worker.reconciler`."""

    alive_file: AliveFile = None
    news_networks: NewsNetworks = ()
    worker_database_url: WorkerDatabase = None
    lease: Lease = timedelta(seconds=14)
    reconcile_every: Seconds = Field(timedelta(seconds=1), description="Time between two checks of all jobs.")
    share_half_life: Annotated[Seconds, Field(ge=timedelta(hours=1))] = Field(
        timedelta(days=3),
        description="After this time half of what users and projects have used counts when turns are given; "
        "at least an hour, such as `P7D`.",
    )

    @model_validator(mode="after")
    def _watches_leases(self) -> Self:
        if self.lease < 3 * self.reconcile_every:
            raise ValueError(
                f"{PREFIX}LEASE ({self.lease.total_seconds():g} s) has to be at least three times "
                f"{PREFIX}RECONCILE_EVERY ({self.reconcile_every.total_seconds():g} s), or no lease ever "
                "runs out: a lease counts only while the reconciler watches it."
            )
        return self


def _is_open(url: str) -> bool:
    """Whether a Redis on another machine is named without a password."""
    parts = urlsplit(url)
    if parts.scheme == "unix" or parts.password:
        return False
    host = parts.hostname or "localhost"
    try:
        return not ip_address(host).is_loopback
    except ValueError:
        return host != "localhost"
