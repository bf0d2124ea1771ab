"""The operator's lists of what cards may name: factories and addresses. It needs no torch."""

import socket
from dataclasses import dataclass
from typing import Self
from urllib.parse import urlsplit

from services.addresses import Address, is_loopback, is_public, read
from services.settings import Settings


@dataclass(frozen=True)
class AllowList:
    """The factories, the URLs and the private addresses that cards may name."""

    factories: frozenset[str] = frozenset()
    endpoints: frozenset[str] = frozenset()

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """The lists in the settings."""
        return cls(settings.allowed_factories, settings.allowed_endpoints)

    def factory_refusal(self, factory: str) -> str | None:
        """Returns the reason for which a card may not name this factory; None if it may."""
        if factory in self.factories:
            return None
        return f"the factory {factory!r} is not allowed; the operator lists it in SCENE_ATTACK_TARGET_FACTORIES"

    def endpoint_refusal(self, endpoint: str) -> str | None:
        """Returns the reason for which a card may not name this URL; None if it may. Asks no name server."""
        if endpoint not in self.endpoints:
            return f"the endpoint {endpoint!r} is not allowed; the operator lists it in SCENE_ATTACK_TARGET_ENDPOINTS"
        try:
            url = urlsplit(endpoint)
            host = url.hostname or ""
        except ValueError as error:
            return f"the endpoint {endpoint!r} is no URL: {error}"
        if url.username or url.password or url.fragment:
            return "the endpoint has a user name, a password or a fragment; leave them out"
        if url.scheme == "https" and host:
            return None
        if url.scheme == "http" and is_loopback(host):
            return None
        return f"the endpoint {endpoint!r} is neither https nor on this machine"

    def resolve(self, host: str, port: int) -> str:
        """Returns an IP address of the host of a URL that may be connected to.

        An address that is not public is allowed if the URL names it itself, or the list does. Connect to what is
        returned, not to the name: another look-up may give another address. Raises OSError if there is none.
        """
        for *_, place in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
            if self._allowed(host, read(str(place[0]))):
                return str(place[0])
        raise OSError(f"{host} has no address that is public or listed in SCENE_ATTACK_TARGET_ENDPOINTS")

    def _allowed(self, host: str, address: Address) -> bool:
        named = host == str(address) or (host == "localhost" and address.is_loopback)
        return is_public(address) or named or str(address) in self.endpoints


NOTHING = AllowList()
"""The lists of an operator who allows nothing."""
