"""Requests that no honest client sends: each has the status of a client's mistake, and the service goes on."""

import json
import socket

import pytest
from httpx import Client

from tests.unit.api.conftest import SPHERE

IDS = {
    "unknown": "none",
    "a folder above": "..%2f..%2fetc%2fpasswd",
    "dots": "%2e%2e",
    "quotes": "'%20OR%201=1--",
    "markup": "%3Cscript%3E",
    "no UTF-8": "%ff%fe",
    "a line end": "a%0d%0aX-Evil:1",
    "a bad escape": "%zz",
    "long": "a" * 5000,
    "a wildcard": "%25",
    "an emoji": "%F0%9F%92%A3",
    "a surrogate": "%ed%a0%80",
}
ROUTES = (
    "GET /v1/jobs/ID",
    "POST /v1/jobs/ID/cancel",
    "GET /v1/jobs/ID/events",
    "GET /v1/jobs/ID/artifacts",
    "GET /v1/jobs/ID/artifacts/ID",
    "GET /v1/campaigns/ID",
    "POST /v1/campaigns/ID/pause",
    "GET /v1/campaigns/ID/views",
    "GET /v1/campaigns/ID/table.csv",
    "GET /jobs/ID",
    "GET /parts/campaigns/ID",
    "GET /static/ID",
)


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("name", IDS)
def test_an_id_of_nothing(client: Client, route: str, name: str) -> None:
    method, path = route.split(" ")
    answer = client.request(method, path.replace("ID", IDS[name]))
    assert answer.status_code == 404, answer.text[:500]
    assert "x-evil" not in answer.headers
    assert "<script>" not in answer.text
    assert "/root" not in answer.text


JSON_TEXTS = {
    "nothing": (b"", 422),
    "a word": (b"hello", 400),
    "half an object": (b'{"scene": ', 400),
    "a list": (b"[]", 422),
    "a number": (b"1", 422),
    "null": (b"null", 422),
    "not a number": (b'{"seed": NaN}', 422),
    "infinity": (b'{"attack": {"epsilon": -Infinity}}', 422),
    "beyond float": (b'{"attack": {"epsilon": 1e999}}', 422),
    "beyond int": (b'{"seed": ' + b"9" * 1000 + b"}", 422),
    "beyond what Python reads": (b'{"seed": ' + b"9" * 100_000 + b"}", 400),
    "no UTF-8": (b'{"name": "\xff\xfe"}', 400),
    "a byte order mark": (b"\xef\xbb\xbf{}", 422),
    "UTF-16": ('{"a": 1}'.encode("utf-16"), 422),
    "half a surrogate": (b'{"name": "\\ud800"}', 422),
    "half a surrogate as a key": (b'{"\\udfff": 1}', 422),
    "NUL as a key": (b'{"\\u0000": 1}', 422),
    "a raw NUL": (b'{"a": "\x00"}', 400),
    "the same key twice": (b'{"scene": {"objects": []}, "scene": 3}', 422),
    "an attribute of classes": (b'{"__class__": {"__init__": 1}}', 422),
    "two documents": (b"{}{}", 400),
}
POSTS = ("/v1/jobs", "/v1/campaigns", "/v1/rerenderings")


@pytest.mark.parametrize("path", POSTS)
@pytest.mark.parametrize("name", JSON_TEXTS)
def test_a_body_that_is_no_request(client: Client, path: str, name: str) -> None:
    body, status = JSON_TEXTS[name]
    answer = client.post(path, content=body, headers={"content-type": "application/json"})
    assert answer.status_code == status, answer.text[:500]
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(answer.content) < 5000


HEADERS = {
    "no type": ({"content-type": ""}, 415),
    "a form": ({"content-type": "application/x-www-form-urlencoded"}, 415),
    "text": ({"content-type": "text/plain"}, 415),
    "half a type": ({"content-type": "application/"}, 415),
    "a type in disguise": ({"content-type": "text/plain; application/json"}, 415),
    "an empty key": ({"idempotency-key": ""}, 422),
    "a long key": ({"idempotency-key": "k" * 256}, 422),
    "another site": ({"origin": "https://evil.example"}, 403),
    "half an origin": ({"origin": "http://["}, 403),
    "two origins": ({"origin": "http://localhost, https://evil.example"}, 403),
    "half a host": ({"host": "[::1"}, 400),
    "a host of another name": ({"host": "evil.example"}, 421),
    "a user in the host": ({"host": "localhost@evil.example"}, 400),
}


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_that_does_not_fit(client: Client, name: str) -> None:
    headers, status = HEADERS[name]
    body = json.dumps(SPHERE).encode()
    answer = client.post("/v1/jobs", content=body, headers={"content-type": "application/json"} | headers)
    assert answer.status_code == status, answer.text[:500]


QUERIES = {
    "limit=0": 422,
    "limit=-1": 422,
    "limit=201": 422,
    "limit=1e2": 422,
    "limit=" + "9" * 5000: 422,
    "limit=": 422,
    "limit=٣": 422,
    "state=nothing": 422,
    "state=QUEUED": 422,
    "state=": 422,
    "state[$ne]=queued": 200,
    "campaign=" + "a" * 33: 422,
    "cursor=" + "A" * 201: 422,
    "cursor=%00": 422,
    "cursor=%ff": 422,
    "cursor=AAAA": 422,
    "cursor==": 422,
    "&&&=&=": 200,
    "limit=1&limit=2": 200,
}


@pytest.mark.parametrize("query", QUERIES, ids=lambda query: query[:30])
def test_a_query_that_does_not_fit(client: Client, query: str) -> None:
    answer = client.get(f"/v1/jobs?{query}")
    assert answer.status_code == QUERIES[query], answer.text[:500]
    assert answer.status_code == 200 or len(answer.content) < 2000


RAW = {
    "no host": (b"GET /healthz HTTP/1.1\r\n\r\n", 400),
    "two hosts": (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nHost: evil\r\n\r\n", 400),
    "no version": (b"GET /healthz\r\n\r\n", 400),
    "a TLS hello": (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n", 400),
    "a space in the path": (b"GET /health z HTTP/1.1\r\nHost: localhost\r\n\r\n", 400),
    "a NUL in a header": (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nA: b\x00c\r\n\r\n", 400),
    "a header without a name": (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n: b\r\n\r\n", 400),
    "a folded header": (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nA: b\r\n c\r\n\r\n", 400),
    "a space before a colon": (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nA : b\r\n\r\n", 400),
    "an endless header": (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nA: " + b"x" * 200_000 + b"\r\n\r\n", 400),
    "a negative length": (b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: -1\r\n\r\n", 400),
    "a length in words": (b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: one\r\n\r\n", 400),
    "two lengths": (
        b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n",
        400,
    ),
    "an unknown encoding": (b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: gzip\r\n\r\n", 400),
    "a chunk of no length": (
        b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Transfer-Encoding: chunked\r\n\r\nzz\r\n{}\r\n0\r\n\r\n",
        400,
    ),
    "a method of one's own": (b"BREW /v1/jobs HTTP/1.1\r\nHost: localhost\r\n\r\n", 400),
    "the whole server": (b"OPTIONS * HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
    "a proxy's request": (b"GET http://evil.example/ HTTP/1.1\r\nHost: localhost\r\n\r\n", 400),
    "a tunnel": (b"CONNECT localhost:22 HTTP/1.1\r\nHost: localhost\r\n\r\n", 400),
    "another protocol": (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: x\r\n\r\n", 200),
}


@pytest.mark.parametrize("name", RAW)
def test_bytes_that_are_hardly_http(client: Client, name: str) -> None:
    sent, status = RAW[name]
    with socket.create_connection((client.base_url.host, client.base_url.port), timeout=60) as connection:
        connection.sendall(sent)
        said = connection.recv(65536)
    assert int(said.split(b" ", 2)[1]) == status, said[:500]
    assert client.get("/healthz").status_code == 200
