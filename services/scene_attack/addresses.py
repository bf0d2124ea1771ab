"""IP addresses and hosts: which are this machine's own, which are of the internet, and which entries of the operator's
lists no host or URL can ever match.
"""

import re
from ipaddress import IPv4Address, IPv6Address, ip_address, ip_network
from urllib.parse import urlsplit

Address = IPv4Address | IPv6Address
_TRANSLATED = ip_network("64:ff9b::/96")
"""Addresses whose last 32 bits are an IPv4 address (NAT64)."""
_TRANSLATED_HERE = ip_network("64:ff9b:1::/48")
"""Addresses that a network translates as it likes; older versions of Python take them for public (RFC 8215)."""


def read(text: str) -> Address:
    """The address in a text, without its zone (%eth0). An IPv4 address that is written as IPv6 (::ffff:10.0.0.1) is the
    IPv4 address. Raises ValueError if the text is no address.
    """
    address = ip_address(text.partition("%")[0])
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return address if mapped is None else mapped


def is_loopback(host: str) -> bool:
    """Whether a host name or address is this machine's loopback."""
    try:
        return host == "localhost" or read(host).is_loopback
    except ValueError:
        return False


def is_public(address: Address) -> bool:
    """Whether an address is public. The IPv4 address that an IPv6 address stands for must be public, too."""
    if isinstance(address, IPv6Address):
        inner = address.ipv4_mapped or address.sixtofour or (address.teredo or (None, None))[1]
        if address in _TRANSLATED_HERE or address.is_site_local:  # Python takes fec0::/10 for global
            return False
        if address in _TRANSLATED:
            inner = IPv4Address(int(address) & 0xFFFFFFFF)
        if inner is not None:
            return is_public(inner)
    return address.is_global and not (address.is_multicast or address.is_reserved or address.is_unspecified)


_NAME = re.compile(r"[a-z0-9._~-]+")


def host_mistake(part: str) -> str | None:
    """Returns the reason why an entry, in lower case, is no name or IP address of a host; None if it is one."""
    if _address(part) is not None:
        return _written(part)
    if _NAME.fullmatch(part):
        return None
    return "a name or IP address of a host is due, without scheme, port, path, brackets and wildcards"


def endpoint_mistake(part: str) -> str | None:
    """Returns the reason why an entry is neither a URL that a card may name nor an IP address; None if it is one."""
    if _address(part) is not None:
        return _written(part)
    try:
        url = urlsplit(part)
        host, _ = url.hostname or "", url.port
    except ValueError as error:
        return f"it is no URL: {error}"
    if url.scheme not in ("http", "https") or not host:
        return "a whole URL is due, such as 'https://host/path', or an IP address"
    if url.username or url.password or url.fragment:
        return "a URL with a user name, a password or a fragment is never asked; leave them out"
    if url.scheme == "http" and not is_loopback(host):
        return "over http only this machine is asked; use https"
    return None


def _written(part: str) -> str | None:
    written = _address(part)
    return None if part == written else f"the address is written {written!r}"


def _address(text: str) -> str | None:
    try:
        return str(read(text))
    except ValueError:
        return None
