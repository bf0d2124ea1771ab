"""Judges IP addresses: which are this machine's own, and which are of the internet."""

from ipaddress import IPv4Address, IPv6Address, ip_address, ip_network

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
    """Whether an address is one of the internet. So must be the IPv4 address that an IPv6 address stands for."""
    if isinstance(address, IPv6Address):
        inner = address.ipv4_mapped or address.sixtofour or (address.teredo or (None, None))[1]
        if address in _TRANSLATED_HERE or address.is_site_local:  # Python takes fec0::/10 for global
            return False
        if address in _TRANSLATED:
            inner = IPv4Address(int(address) & 0xFFFFFFFF)
        if inner is not None:
            return is_public(inner)
    return address.is_global and not (address.is_multicast or address.is_reserved or address.is_unspecified)
