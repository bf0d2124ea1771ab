"""Entries of lists of hosts and URLs that can never match are refused, and say what would."""

import pytest
from pydantic import ValidationError

from services.addresses import endpoint_mistake, host_mistake
from services.settings import Settings


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
