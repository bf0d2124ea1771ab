"""Which addresses are of the internet, and which are this machine's; entries of lists of hosts that can never match."""

import socket
from ipaddress import ip_address

import pytest
from pydantic import ValidationError

from scene_attack.addresses import endpoint_mistake, host_mistake, is_loopback, is_public, read
from scene_attack.targets.custom.card import NOTHING
from scene_attack_service.settings import Settings

ADDRESSES = {
    "8.8.8.8": True,
    "2606:4700::1111": True,
    "127.0.0.1": False,
    "10.0.0.1": False,
    "172.16.0.1": False,
    "192.168.1.1": False,
    "169.254.169.254": False,
    "100.64.0.1": False,
    "0.0.0.0": False,
    "224.0.0.1": False,
    "255.255.255.255": False,
    "::": False,
    "::1": False,
    "fe80::1": False,
    "fc00::1": False,
    "fec0::1": False,
    "ff02::1": False,
    "::ffff:127.0.0.1": False,
    "::ffff:8.8.8.8": True,
    "2002:7f00:1::": False,
    "64:ff9b::7f00:1": False,
    "64:ff9b::a9fe:a9fe": False,
    "64:ff9b::808:808": True,
    "64:ff9b:1::808:808": False,
    "2001:0:4136:e378:8000:63bf:80ff:fffe": False,  # Teredo, of 127.0.0.1
    "::127.0.0.1": False,
}


@pytest.mark.parametrize("address", ADDRESSES)
def test_which_addresses_are_public(address: str) -> None:
    assert is_public(ip_address(address)) == ADDRESSES[address]


def test_the_endpoint_of_a_card_is_judged_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [(socket.AF_INET, socket.SOCK_STREAM, 0, "", (one, 443)) for one, is_one in ADDRESSES.items() if not is_one]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)  # a name server that answers these
    with pytest.raises(OSError, match="no address that is public"):
        NOTHING.resolve("receiver.example", 443)


LOOPBACK = {
    **dict.fromkeys(("localhost", "127.0.0.1", "127.1.2.3", "::1", "::ffff:127.0.0.1", "::1%lo"), True),
    **dict.fromkeys(("", "0.0.0.0", "::", "::ffff:10.0.0.1", "localhost.example", "[::1]", "127.1"), False),
}


@pytest.mark.parametrize("host", LOOPBACK)
def test_which_hosts_are_loopback(host: str) -> None:
    assert is_loopback(host) == LOOPBACK[host]


def test_an_ipv4_address_has_one_form() -> None:
    assert read("::ffff:10.0.0.1") == ip_address("10.0.0.1")
    assert read("fe80::1%eth0") == ip_address("fe80::1")


@pytest.mark.parametrize("part", ["api", "me.example", "10.0.0.7", "::1", "fd00::7", "a-b_c.example"])
def test_a_host_is_taken(part: str) -> None:
    assert host_mistake(part) is None


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ("https://me.example/path", "without scheme, port, path"),
        ("me.example/", "without scheme, port, path"),
        ("me.example:8008", "without scheme, port, path"),
        ("*.example", "without scheme, port, path"),
        ("fd00::0007", "the address is written 'fd00::7'"),
        ("::ffff:10.0.0.7", "the address is written '10.0.0.7'"),
        ("me example", "without scheme, port, path"),
        ("[fd00::7]", "without scheme, port, path"),
        ("[fd00::7]:8008", "without scheme, port, path"),
    ],
)
def test_a_host_that_can_never_match_says_why(part: str, said: str) -> None:
    assert said in str(host_mistake(part))


@pytest.mark.parametrize(
    "part", ["https://me.example/score", "http://127.0.0.1:8900/", "http://localhost/", "10.0.0.7"]
)
def test_an_endpoint_is_taken(part: str) -> None:
    assert endpoint_mistake(part) is None


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ("me.example", "a whole URL is due"),
        ("ftp://me.example/", "a whole URL is due"),
        ("http://me.example/", "use https"),
        ("https://me:secret@me.example/", "leave them out"),
        ("https://me.example:port/", "it is no URL"),
        ("FD00::7", "the address is written 'fd00::7'"),
        ("::ffff:10.0.0.7", "the address is written '10.0.0.7'"),
    ],
)
def test_an_endpoint_that_can_never_match_says_why(part: str, said: str) -> None:
    assert said in str(endpoint_mistake(part))


@pytest.mark.parametrize(
    ("name", "value"),
    [("hosts", "a,https://b"), ("hosts", "B.example:443"), ("target_endpoints", "http://b.example/")],
)
def test_the_settings_refuse_them(name: str, value: str) -> None:
    with pytest.raises(ValidationError, match="can never match"):
        Settings(**{name: value})


def test_hosts_are_compared_in_lower_case() -> None:
    values = Settings(hosts="Me.Example, FD00::7", host="127.0.0.1")
    assert values.own_hosts == {"me.example", "fd00::7", "127.0.0.1"}
