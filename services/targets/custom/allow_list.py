"""Checks the factory or the address that a card names against the operator's lists. It needs no torch."""

import socket
from ipaddress import IPv4Address, IPv6Address, ip_address

import httpx

from services.settings import settings

Address = IPv4Address | IPv6Address


def factory_refusal(factory: str) -> str | None:
    """Returns the reason for which a card may not name this factory; None if it may."""
    if factory in settings().allowed_factories:
        return None
    return f"the factory {factory!r} is not allowed; the operator lists it in SCENE_ATTACK_TARGET_FACTORIES"


def endpoint_refusal(endpoint: str) -> str | None:
    """Returns the reason for which a card may not name this URL; None if it may. Asks no name server."""
    if endpoint not in settings().allowed_endpoints:
        return f"the endpoint {endpoint!r} is not allowed; the operator lists it in SCENE_ATTACK_TARGET_ENDPOINTS"
    try:
        url = httpx.URL(endpoint)
    except httpx.InvalidURL as error:
        return f"the endpoint {endpoint!r} is no URL: {error}"
    if url.userinfo or url.fragment:
        return "the endpoint has a user name, a password or a fragment; leave them out"
    if url.scheme == "https" and url.host:
        return None
    if url.scheme == "http" and _is_loopback(url.host):
        return None
    return f"the endpoint {endpoint!r} is neither https nor on this machine"


def resolve(url: httpx.URL) -> str:
    """Returns an IP address of the URL's host that may be connected to.

    An address that is not public is allowed if the URL names it itself, or the operator's list does. Connect to what is
    returned, not to the name: another look-up may give another address. Raises OSError if there is none.
    """
    found = socket.getaddrinfo(url.host, url.port or (443 if url.scheme == "https" else 80), type=socket.SOCK_STREAM)
    for *_, place in found:
        if _allowed(url.host, _plain(str(place[0]))):
            return str(place[0])
    raise OSError(f"{url.host} has no address that is public or listed in SCENE_ATTACK_TARGET_ENDPOINTS")


def _allowed(host: str, address: Address) -> bool:
    named = host == str(address) or (host == "localhost" and address.is_loopback)
    return address.is_global or named or str(address) in settings().allowed_endpoints


def _plain(text: str) -> Address:
    """The address; an IPv4 address written as IPv6 is the former."""
    address = ip_address(text.partition("%")[0])
    mapped = getattr(address, "ipv4_mapped", None)
    return address if mapped is None else mapped


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
