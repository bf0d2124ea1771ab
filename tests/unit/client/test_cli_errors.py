"""What goes wrong around the service is said in one line, with the setting or option to mend, and no traceback."""

import socket
import socketserver
import ssl
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.certificates import self_signed
from tests.unit.client.command_line import Done, cli, process

pytestmark = pytest.mark.slow

NOBODY = "http://127.0.0.1:1"


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that somebody else listens on."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


def said(*arguments: str, **environ: str) -> tuple[int, str]:
    """The exit code, and what follows "scene-attack: " in the last line of stderr, which has no traceback."""
    return _said(cli(*arguments, **environ))


def process_said(*arguments: str, **environ: str) -> tuple[int, str]:
    """The same of a process: parts of a service change the process in which they start."""
    return _said(process(*arguments, **environ))


def _said(done: Done) -> tuple[int, str]:
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    return done.returncode, done.stderr.splitlines()[-1].removeprefix("scene-attack: ")


@pytest.mark.parametrize("program", ["serve", "api"])
def test_a_taken_port(program: str, taken: int, tmp_path: Path) -> None:
    redis = {"SCENE_ATTACK_REDIS_URL": "redis://127.0.0.1:1"}
    code, text = process_said(program, "--port", str(taken), "--data", str(tmp_path), **redis)
    assert (code, text) == (
        2,
        f"bad input: --port: cannot listen on 127.0.0.1:{taken} (Address already in use); try --port 0",
    )


@pytest.mark.parametrize("program", ["serve", "api", "worker"])
def test_a_data_folder_that_cannot_be_made(program: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    redis = {"SCENE_ATTACK_REDIS_URL": "redis://127.0.0.1:1"}
    code, text = process_said(program, "--data", str(tmp_path / "file"), **redis)
    assert code == 2
    assert text.startswith(f"bad input: SCENE_ATTACK_DATA: the folder {tmp_path / 'file'} cannot be made")


@pytest.mark.parametrize("program", ["api", "worker"])
def test_no_redis_for_parts_of_the_service(program: str, tmp_path: Path) -> None:
    code, text = process_said(program, "--data", str(tmp_path / "data"))
    assert code == 2
    assert text.startswith("bad input: SCENE_ATTACK_REDIS_URL: is needed")
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("program", ["serve", "api", "worker"])
def test_a_url_that_is_no_redis_is_not_shown_because_it_may_have_a_password(program: str, tmp_path: Path) -> None:
    code, text = process_said(
        program, "--data", str(tmp_path / "data"), SCENE_ATTACK_REDIS_URL="http://:secret@redis:6379"
    )
    assert code == 2
    assert text.startswith("bad input: SCENE_ATTACK_REDIS_URL: must be a URL such as redis://")
    assert "secret" not in text


@pytest.mark.parametrize("command", ["serve", "keys list"])
def test_a_database_that_is_away(command: str, tmp_path: Path) -> None:
    url = "postgresql://alice:secret@127.0.0.1:1/scenes"
    code, text = process_said(*command.split(), SCENE_ATTACK_DATABASE_URL=url, SCENE_ATTACK_DATA=str(tmp_path / "data"))
    assert code == 1
    assert text.startswith("the database does not answer")
    assert text.endswith("scene-attack doctor says what to do")
    assert "secret" not in text


@pytest.mark.parametrize("url", ["127.0.0.1:8008", "htp://127.0.0.1", "http://"])
def test_an_address_that_is_none(url: str) -> None:
    code, text = said("jobs", "list", "--url", url)
    assert code == 2
    assert text == f"bad input: --url: '{url}' is no address of a service, such as http://127.0.0.1:8008"


@pytest.mark.parametrize("url", ["http://host/v1", "http://host/v1/", "http://host/v1/jobs"])
def test_an_address_with_the_version_of_the_api(url: str) -> None:
    code, text = said("jobs", "list", "--url", url)
    assert code == 2
    assert text == f"bad input: --url: '{url}' has /v1, which is added to the address: give http://host"


@pytest.fixture
def website() -> Iterator[int]:
    """The port of a web server that knows nothing of this API."""

    class Page(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.recv(65536)
            self.request.sendall(b"HTTP/1.1 501 Not Implemented\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Page) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


def test_https_to_a_port_of_http(website: int) -> None:
    code, text = said("jobs", "list", "--url", f"https://127.0.0.1:{website}")
    assert code == 1
    assert text == f"https://127.0.0.1:{website} does not speak https; try --url http://127.0.0.1:{website}"


def test_a_certificate_that_nobody_signed(tmp_path: Path) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(self_signed(tmp_path), tmp_path / "key.pem")
    listener = socket.create_server(("127.0.0.1", 0))

    def answer() -> None:
        with suppress(ssl.SSLError, ConnectionError):
            context.wrap_socket(listener.accept()[0], server_side=True).close()

    with listener:
        thread = threading.Thread(target=answer)
        thread.start()
        origin = f"https://localhost:{listener.getsockname()[1]}"
        code, text = said("jobs", "list", "--url", origin)
        thread.join()
    assert code == 1
    assert text.startswith(f"the certificate of {origin} is not trusted (")
    assert text.endswith("); SSL_CERT_FILE names one that is")


def test_another_web_server(website: int) -> None:
    code, text = said("jobs", "list", "--url", f"http://127.0.0.1:{website}")
    assert code == 1
    assert text.startswith(f"refused: HTTP 501 from http://127.0.0.1:{website}/v1/jobs")
    assert text.endswith("which is no answer of this service; check --url")


def test_a_host_that_does_not_exist() -> None:
    code, text = said("jobs", "list", "--url", "http://no-such-host.invalid")
    assert code == 1
    assert text == "there is no host 'no-such-host.invalid'; name the service with --url"


def test_a_redis_that_is_away(tmp_path: Path) -> None:
    url = "redis://:secret@127.0.0.1:1"
    code, text = process_said("serve", "--port", "0", "--data", str(tmp_path), SCENE_ATTACK_REDIS_URL=url)
    assert code == 2
    assert text.startswith("bad input: SCENE_ATTACK_REDIS_URL: no Redis answers there (")
    assert text.endswith("start it, or unset the variable, and serve brings one")
    assert "secret" not in text


def test_every_wrong_field_has_a_line(tmp_path: Path) -> None:
    spec = '{"scene": {"objects": [{"mesh": 3}], "camera": {"elevation": 90}}, "attack": {"steps": -1}}'
    done = cli("run", "-", "--out", str(tmp_path / "out"), stdin=spec)
    assert done.returncode == 2
    lines = [line.removeprefix("scene-attack: bad input: ") for line in done.stderr.splitlines()]
    found = {line.partition(": ")[0]: line for line in lines}
    assert set(found) == {"scene.camera.elevation", "scene.objects.0.mesh", "attack.steps"}
    assert found["scene.camera.elevation"].endswith("; 90 looks like degrees: π/2 is 1.5708")


@pytest.mark.parametrize(
    ("command", "spec", "instead"),
    [
        ("run", "examples/campaign-small.json", "is a campaign; `scene-attack campaign run"),
        ("campaign run", "examples/torch-combined.json", "is a job; `scene-attack run"),
    ],
)
def test_a_job_is_no_campaign(command: str, spec: str, instead: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, text = said(*command.split(), spec, "--out", str(out))
    assert (code, text) == (2, f"bad input: SPEC: {spec} {instead} {spec}` runs it")
    assert not out.exists()


def test_every_wrong_setting_has_a_line() -> None:
    wrong = {"SCENE_ATTACK_PORT": "http", "SCENE_ATTACK_WORKERS": "0", "SCENE_ATTACK_HOSTS": "https://me.example/"}
    done = cli("serve", **wrong)
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        'scene-attack: bad input: SCENE_ATTACK_PORT: must be an integer, not "http"',
        "scene-attack: bad input: SCENE_ATTACK_HOSTS: 'https://me.example/' can never match: a name or IP "
        "address of a host is due, without scheme, port, path, brackets and wildcards",
        'scene-attack: bad input: SCENE_ATTACK_WORKERS: must be at least 1, not "0"',
    ]


def test_a_folder_that_is_no_result_is_named_before_anything_is_loaded(tmp_path: Path) -> None:
    for command in ("replay", "analyse"):
        done = cli(command, str(tmp_path / "nothing"))
        assert done.returncode == 2
        said = f"directory: {tmp_path / 'nothing'} is not the output of a finished job: there is no file "
        assert done.stderr == f"scene-attack: bad input: {said}{tmp_path / 'nothing' / 'result.json'}\n"


def test_ctrl_c_while_modules_are_imported_is_no_traceback() -> None:
    code = (
        "import builtins, sys; sys.argv = ['scene-attack', 'targets']; found = builtins.__import__\n"
        "def late(name, *more):\n    if name == 'typer': raise KeyboardInterrupt\n    return found(name, *more)\n"
        "builtins.__import__ = late\nfrom scene_attack.__main__ import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "scene-attack: interrupted\n")


@pytest.mark.parametrize("key", ["sa_schlüssel", "sa_a\nb"])
def test_a_key_that_is_none(key: str) -> None:
    code, text = said("jobs", "list", "--url", NOBODY, SCENE_ATTACK_KEY=key)
    assert code == 2
    assert text.startswith("bad input: SCENE_ATTACK_KEY: ")
    assert key not in text


def test_a_picture_in_a_folder_that_is_not_there(tmp_path: Path) -> None:
    picture = tmp_path / "none/picture.png"
    code, text = said("render", "examples/torch-combined.json", "--out", str(picture))
    assert (code, text) == (2, f"bad input: --out: there is no folder {picture.parent}; make it first")


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    code, text = said("jobs", "download", "0f3c", "--url", NOBODY, "--out", str(tmp_path / "file/out"))
    assert code == 2
    assert text.startswith(f"bad input: --out: cannot make the directory {tmp_path / 'file/out'}")


def test_a_folder_of_a_network_that_is_left_out_is_named_where_it_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "mine/empty").mkdir(parents=True)
    targets = {"SCENE_ATTACK_TARGETS": str(tmp_path / "mine")}
    assert "target left out: empty: card.json" in process("targets", **targets).stderr
    assert process("plan", "no-such-file", **targets).stderr.startswith("scene-attack: bad input: SPEC: ")
    assert "card.json" in process("targets", "check", "empty", **targets).stderr
