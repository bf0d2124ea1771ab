"""Finds entries of the operator's lists of hosts and URLs that no host or URL can ever match."""

import re
from urllib.parse import urlsplit

from services.addresses import is_loopback, read

_NAME = re.compile(r"[a-z0-9._~-]+")


def host_mistake(part: str) -> str | None:
    """Why an entry, in lower case, is no name or IP address of a host; None if it is one."""
    if _address(part) is not None:
        return _written(part)
    if "://" in part or "/" in part:
        return f"a host is due, without scheme and path, such as {_host_in(part)!r}"
    if "*" in part:
        return "there are no wildcards; list each host"
    name, colon, port = part.rpartition(":")
    if colon and port.isdigit():
        return f"a host is due, without a port: {name.strip('[]')!r}"
    if part.startswith("[") and _address(part.strip("[]")) is not None:
        return f"the brackets of an address belong to URLs: {part.strip('[]')!r}"
    return None if _NAME.fullmatch(part) else "it is no name or IP address of a host"


def endpoint_mistake(part: str) -> str | None:
    """Why an entry is neither a URL that a card may name nor an IP address; None if it is one."""
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


def _host_in(text: str) -> str:
    return text.partition("://")[2].partition("/")[0].rpartition("@")[2] or text.partition("/")[0]
