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
    "beyond what Python reads": (b'{"seed": ' + b"9" * 100_000 + b"}", 422),
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
INTERNALS = ("UploadFile", "There was an error", "sys.", "Expecting", "codec", "<class", "Error)", "^[", "Headers(")
POSTS = ("/v1/jobs", "/v1/campaigns", "/v1/rerenderings")


@pytest.mark.parametrize("path", POSTS)
@pytest.mark.parametrize("name", JSON_TEXTS)
def test_a_body_that_is_no_request(client: Client, path: str, name: str) -> None:
    body, status = JSON_TEXTS[name]
    answer = client.post(path, content=body, headers={"content-type": "application/json"})
    assert answer.status_code == status, answer.text[:500]
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(answer.content) < 5000
    assert not [one for one in INTERNALS if one in answer.text], answer.text


def part(head: str, data: str = "x") -> str:
    return f"--b\r\ncontent-disposition: form-data; {head}\r\n\r\n{data}\r\n"


FILE = part('name="file"; filename="m.obj"', "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
FORMS = {
    "a text for a file": ("/v1/assets", part('name="file"'), "file.0", "must be a file"),
    "a text beside a file": ("/v1/assets", FILE + part('name="file"'), "file.1", "must be a file"),
    "a file for a text": (
        "/v1/assets",
        FILE + part('name="name"; filename="k"'),
        "name",
        'must be a text, not "a file"',
    ),
    "a file for a choice": ("/v1/assets", FILE + part('name="up"; filename="k"'), "up", "must be one of 'y' or 'z'"),
    "too many files": (
        "/v1/assets",
        "".join(part(f'name="file"; filename="{k}.png"') for k in range(501)),
        "file",
        "must have at most 500 items, not 501",
    ),
    "a file for a request": ("/new", part('name="spec"; filename="s"'), "spec", "must be a text"),
    "a file for a key": ("/sign-in", part('name="key"; filename="k"'), "key", "must be a text"),
    "a file for an action": (
        "/jobs/selected",
        part('name="action"; filename="k"'),
        "action",
        "must be one of 'cancel'",
    ),
}


@pytest.mark.parametrize("name", FORMS)
def test_a_form_with_a_wrong_part_is_answered_in_words(client: Client, name: str) -> None:
    path, parts, field, said = FORMS[name]
    kind = {"content-type": "multipart/form-data; boundary=b"}
    answer = client.post(path, content=f"{parts}--b--\r\n", headers=kind)
    assert answer.status_code == 422, answer.text
    (error,) = answer.json()["errors"]
    assert error["field"] == field
    assert said in error["detail"]
    assert not [one for one in INTERNALS if one in answer.text], answer.text


def test_a_misspelt_field_is_answered_by_those_that_there_are(client: Client) -> None:
    """Those of the request itself, and not those of a job."""
    for path, there in (("/v1/rerenderings", "image, scene"), ("/v1/campaigns", "name, grids")):
        answer = client.post(path, json={"uri": "https://example.org/"}).json()
        [detail] = [error["detail"] for error in answer["errors"] if error["field"] == "uri"]
        assert detail.startswith(f"there is no such field; there are {there}"), detail


@pytest.mark.parametrize(
    ("body", "status", "said"),
    [
        ('{"scene": {"objects"', 400, "it is not JSON: a colon is missing at line 1, column 21"),
        ('{"seed": ' + "9" * 5000 + "}", 422, "body: it has a number of more than 4,300 digits"),
        ("[" * 5000 + "]" * 5000, 422, "body: it is nested deeper than 64 lists and objects"),
        ('{"a": "\xe9"}', 400, "it is not UTF-8 text: byte 8 cannot be"),
    ],
    ids=["half", "a long number", "nested", "latin-1"],
)
@pytest.mark.parametrize("path", [*POSTS, "/v1/preview"])
def test_a_body_that_cannot_be_read_is_answered_in_words(
    client: Client, path: str, body: str, status: int, said: str
) -> None:
    answer = client.post(path, content=body.encode("latin-1"), headers={"content-type": "application/json"})
    assert (answer.status_code, said in answer.json()["detail"]) == (status, True), answer.text


def test_a_form_that_is_none_is_answered_in_words(client: Client) -> None:
    answer = client.post("/v1/assets", content="x", headers={"content-type": "multipart/form-data; boundary=b"})
    assert answer.status_code == 400
    assert answer.json()["detail"].startswith("the body cannot be read as a form: ")


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
    "an origin without a host": ({"origin": "null"}, 403),
    "half a host": ({"host": "[::1"}, 400),
    "a long host": ({"host": "x" * 10_000}, 421),
    "a port that is none": ({"host": "localhost:x"}, 400),
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
    "a folded header": (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nA: b\r\n c\r\n\r\n", 200),
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
    "a method of one's own": (b"BREW /v1/jobs HTTP/1.1\r\nHost: localhost\r\n\r\n", 405),
    "the whole server": (b"OPTIONS * HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
    "a proxy's request": (b"GET http://evil.example/ HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
    "a tunnel": (b"CONNECT localhost:22 HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
    "another protocol": (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: x\r\n\r\n", 200),
}


def closes(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:  # it had not read all that was sent
        return True


@pytest.mark.parametrize("name", RAW)
def test_bytes_that_are_hardly_http(client: Client, name: str) -> None:
    sent, status = RAW[name]
    with socket.create_connection((client.base_url.host, client.base_url.port), timeout=60) as connection:
        connection.sendall(sent)
        said = connection.recv(65536)
        if said.endswith(b"\r\n\r\n"):  # the body comes by itself
            said += connection.recv(65536)
        closed = status != 400 or closes(connection)
    head, _, body = said.partition(b"\r\n\r\n")
    assert int(head.split(b" ", 2)[1]) == status, said[:500]
    # docs/service.md says so: the server below the application knows no problem documents.
    kind = {400: b"text/plain", 200: b"application/json"}.get(status, b"application/problem+json")
    assert b"\r\ncontent-type: " + kind in head
    assert body
    assert closed
    assert client.get("/healthz").status_code == 200
