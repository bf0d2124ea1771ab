"""Finds entries of the operator's lists of hosts and URLs that no host or URL can ever match."""

import re
from ipaddress import ip_address
from urllib.parse import urlsplit

_NAME = re.compile(r"[a-z0-9._~-]+")


def host_mistake(part: str) -> str | None:
    """Why an entry is no name or IP address of a host; None if it is one."""
    if _is_address(part):
        return None if part == str(ip_address(part)) else f"addresses are written like {str(ip_address(part))!r}"
    if "://" in part or "/" in part:
        return f"a host is due, without scheme and path, such as {_host_in(part)!r}"
    if "*" in part:
        return "there are no wildcards; list each host"
    name, colon, port = part.rpartition(":")
    if colon and port.isdigit():
        return f"a host is due, without a port: {name!r}"
    if part != part.lower():
        return f"hosts are compared in lower case: {part.lower()!r}"
    return None if _NAME.fullmatch(part) else "it is no name or IP address of a host"


def endpoint_mistake(part: str) -> str | None:
    """Why an entry is neither a URL that a card may name nor an IP address; None if it is one."""
    if _is_address(part):
        return None if part == str(ip_address(part)) else f"addresses are written like {str(ip_address(part))!r}"
    try:
        url = urlsplit(part)
        host, _ = url.hostname or "", url.port
    except ValueError as error:
        return f"it is no URL: {error}"
    if url.scheme not in ("http", "https") or not host:
        return "a whole URL is due, such as 'https://host/path', or an IP address"
    if url.username is not None or url.password is not None or url.fragment:
        return "a URL with a user name, a password or a fragment is never asked; leave them out"
    if url.scheme == "http" and not (host == "localhost" or _is_loopback(host)):
        return "over http only this machine is asked; use https"
    return None


def _host_in(text: str) -> str:
    return text.partition("://")[2].partition("/")[0].rpartition("@")[2] or text.partition("/")[0]


def _is_address(text: str) -> bool:
    try:
        ip_address(text)
    except ValueError:
        return False
    return True


def _is_loopback(host: str) -> bool:
    return _is_address(host) and ip_address(host).is_loopback
