"""The PostgreSQL of a load: it is started again after what is done to it."""

import signal
from collections.abc import Iterator

import psycopg
import pytest

from benchmarks.postgresql import Server

pytestmark = pytest.mark.slow


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server({})
    try:
        server.start()
        server.wait()
        yield server
    finally:
        server.stop()


def test_a_server_that_was_killed_while_it_was_stopped_starts_again(server: Server) -> None:
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for process in server.processes():
            process.send_signal(number)
    server.start()  # whose predecessor nobody has waited for
    server.wait()
    with psycopg.connect(server.url("postgres")) as connection:
        assert connection.execute("SELECT 1").fetchone() == (1,)
