"""Redis as other machines reach it: by TCP, with a password, over TLS. The server is real. TLS ends in this process, as
the server that comes with the project is built without it.
"""

import asyncio
import ssl
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from redis import exceptions

from scene_attack.client.states import Priority
from scene_attack_service.jobs.queue import Queue, connect
from tests import redis_over_tcp
from tests.certificates import self_signed
from tests.redis_over_tcp import QUOTED

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """The port of a Redis that asks for a password."""
    with redis_over_tcp.running() as port:
        yield port


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return self_signed(tmp_path_factory.mktemp("tls"))


@pytest.fixture(scope="module")
def tls_port(port: int, certificate: Path) -> Iterator[int]:
    """The port at which the same Redis is reached over TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, certificate.with_name("key.pem"))

    async def copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(65536):
                writer.write(data)
                await writer.drain()
        writer.close()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        redis_reader, redis_writer = await asyncio.open_connection("127.0.0.1", port)
        await asyncio.gather(copy(reader, redis_writer), copy(redis_reader, writer))

    loop = asyncio.new_event_loop()
    server = loop.run_until_complete(asyncio.start_server(serve, "127.0.0.1", 0, ssl=context))
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    yield server.sockets[0].getsockname()[1]
    server.close()
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
    for task in asyncio.all_tasks(loop):
        task.cancel()
    loop.run_until_complete(loop.shutdown_asyncgens())
    loop.close()


def test_a_queue_with_a_password_over_tls(tls_port: int, certificate: Path) -> None:
    with connect(f"rediss://:{QUOTED}@localhost:{tls_port}/0?ssl_ca_certs={certificate}") as redis:
        queue = Queue(redis)
        queue.ring()
        assert queue.bells(Priority.NORMAL) == 1


def test_a_certificate_that_nobody_trusts_is_refused(tls_port: int) -> None:
    with (
        connect(f"rediss://:{QUOTED}@localhost:{tls_port}/0") as redis,
        pytest.raises(exceptions.ConnectionError, match="verify"),
    ):
        redis.ping()


def test_a_certificate_of_another_host_is_refused(tls_port: int, certificate: Path) -> None:
    url = f"rediss://:{QUOTED}@127.0.0.1:{tls_port}/0?ssl_ca_certs={certificate}"
    with connect(url) as redis, pytest.raises(exceptions.ConnectionError, match="not valid for"):
        redis.ping()


def test_without_the_password_nothing_is_sent(port: int) -> None:
    with connect(f"redis://127.0.0.1:{port}/0") as redis, pytest.raises(exceptions.AuthenticationError):
        Queue(redis).ring()
