"""The settings of an operator, read from environment variables (prefix SCENE_ATTACK_); the defaults work on a laptop.

A process or a command makes its `Settings()` once, where it begins, and passes them on as an argument.
"""

from collections.abc import Mapping

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from scene_attack.addresses import host_mistake
from scene_attack.options import PREFIX, Options, listed
from scene_attack.runs.environment import read
from scene_attack.text import did_you_mean

COMMAND_LINE = ("SCENE_ATTACK_URL", "SCENE_ATTACK_KEY")
"""Variables that are no settings of the service: where a client finds it, and with which key."""


class Settings(Options, BaseSettings):
    """All settings of an operator: the engine's options, and the service's own.

    `scene-attack serve --help` and docs/operations.md describe them.
    """

    model_config = SettingsConfigDict(env_prefix=PREFIX, env_ignore_empty=True, frozen=True)

    database_url: str | None = Field(
        None,
        description="SQLAlchemy URL, of PostgreSQL for several machines; default: SQLite (WAL) in the data directory",
    )
    redis_url: str | None = Field(
        None, description="redis:// URL, or rediss:// for TLS, with its password; default: an embedded Redis"
    )
    host: str = Field("127.0.0.1", description="address the API listens on")
    port: int = Field(8008, ge=0, le=65535, description="port the API listens on; 0 picks a free one")
    hosts: str | None = Field(
        None,
        description="names by which clients may call the service besides those of loopback, separated by commas",
    )
    workers: int = Field(1, ge=1, le=64, description="job processes")
    check_seconds: float = Field(
        5.0,
        gt=0,
        description="longest check of a request, and a tenth of it the longest wait for one; after either a job is "
        "accepted, and checked by its worker; a preview, its plan, and the wait for either may take twice as long",
    )
    max_queued: int = Field(1000, ge=1, description="queued jobs beyond which new ones get 503")
    owner_queued: int = Field(
        500, ge=1, description="queued jobs of one owner of keys beyond which its new ones get 429; so below likewise"
    )
    owner_campaigns: int = Field(50, ge=1, description="campaigns of one owner that have not ended")
    owner_upload_bytes: int = Field(10 * 2**30, ge=0, description="bytes of all uploads of one owner")
    lease_seconds: float = Field(12.0, gt=0, description="a running job whose worker is silent so long is taken back")
    stall_seconds: float = Field(
        40.0,
        gt=0,
        description="a process that gives no sign of life for so long hangs: it is killed, and its job goes on; a job "
        "process's sign is that it uses the processor",
    )
    cache_bytes: int = Field(
        10 * 2**30, ge=0, description="processed meshes in the cache; beyond it those that were not used for longest go"
    )
    retention_days: float | None = Field(
        None, gt=0, description="jobs and campaigns are deleted so long after their end; default: never"
    )
    job_seconds: float = Field(
        3600.0,
        gt=0,
        description="longest run of one job before it fails as timeout; a tenth of it, at most 30 seconds, is for "
        "keeping what the attack has found",
    )
    job_memory_bytes: int | None = Field(
        None,
        ge=2 * 2**30,
        description="memory of a job process and of one that checks requests, in bytes; beyond it the job fails as "
        "out-of-memory; default: an equal share of the machine's memory, of 4 to 16 GiB",
    )

    @field_validator("hosts")
    @classmethod
    def _can_match(cls, value: str | None) -> str | None:
        for part in sorted(listed(value)):
            refusal = host_mistake(part.lower())
            if refusal is not None:
                raise ValueError(f"{part!r} can never match: {refusal}")
        return value

    @field_validator("database_url")
    @classmethod
    def _is_kept(cls, value: str | None) -> str | None:
        if value is not None and value.startswith("sqlite") and value.partition(":")[2].strip("/") in ("", ":memory:"):
            raise ValueError("a database in memory is lost with its process; name a file, or leave it out")
        return value

    @property
    def own_hosts(self) -> frozenset[str]:
        """The names by which clients may call the service, besides loopback's: those listed, and its own address."""
        named = {host.lower() for host in listed(self.hosts)}
        return frozenset(named | {self.host.lower()}) - {"", "0.0.0.0", "::"}


def read_settings(**given: object) -> Settings:
    """The settings of the environment, with the `given` options over them; None stands for an option left out.

    Raises InvalidFields, which names each wrong option or variable.
    """
    return read(lambda chosen: Settings(**chosen), given)  # type: ignore[arg-type]


def unknown_variables(environ: Mapping[str, str]) -> dict[str, str]:
    """The variables of an environment that look like settings and are none, each with its error."""
    known = [*(f"{PREFIX}{name.upper()}" for name in Settings.model_fields), *COMMAND_LINE]
    unknown = sorted(name for name in environ if name.startswith(PREFIX) and name not in known)
    return {name: f"there is no such setting{did_you_mean(name, known)}" for name in unknown}


DEFAULTS = Settings.model_construct()
"""The defaults, whatever the environment says."""
