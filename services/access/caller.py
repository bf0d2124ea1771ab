"""The caller of a request: an owner and what it may do."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

from services.jobs.models import Campaign, Job

Owned = TypeVar("Owned", Job, Campaign)


class Scope(StrEnum):
    """What a key allows. `admin` allows everything, and to see what every owner has."""

    JOBS_READ = "jobs:read"
    JOBS_WRITE = "jobs:write"
    ASSETS_WRITE = "assets:write"
    METRICS_READ = "metrics:read"
    ADMIN = "admin"


@dataclass(frozen=True)
class Caller:
    """Who sends a request: the owner of what it makes, its scopes, and the prefix of its key, "" for no key."""

    owner: str
    scopes: frozenset[Scope]
    key: str

    @classmethod
    def of(cls, owner: str, scopes: Iterable[str], key: str) -> "Caller":
        """The caller with these scopes; words that are no scope, of another version, allow nothing."""
        return cls(owner, frozenset(scope for scope in Scope if scope in set(scopes)), key)

    def may(self, scope: Scope) -> bool:
        """Whether the caller's scopes allow what needs `scope`."""
        return scope in self.scopes or Scope.ADMIN in self.scopes

    @property
    def only(self) -> str | None:
        """The owner whose jobs, campaigns and uploads the caller sees; None sees those of all."""
        return None if self.may(Scope.ADMIN) else self.owner

    def visible(self, found: Owned | None) -> Owned | None:
        """`found` if the caller sees its owner's, else None: what others have does not exist for the caller."""
        return found if found is not None and self.only in (None, found.owner) else None


KEYLESS = Caller("", frozenset(Scope), "")
"""Any program of this machine while there is no key: it may do everything, and what it makes belongs to ""."""
