"""Which addresses are of the internet, and which are this machine's, also of IPv6 ones that stand for others."""

import socket
from ipaddress import ip_address

import pytest

from services.addresses import is_loopback, is_public, read
from services.targets.custom.card import NOTHING

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


@pytest.mark.parametrize("address", [address for address, is_one in ADDRESSES.items() if not is_one])
def test_the_endpoint_of_a_card_is_judged_alike(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = [(socket.AF_INET, socket.SOCK_STREAM, 0, "", (address, 443))]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)  # a name server that answers this
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
