import hashlib

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.targets.download import ATTEMPTS, fetch
from scene_attack.targets.info import Published

pytestmark = pytest.mark.slow

DATA = bytes(range(256)) * 4096
NAME = f"net-{hashlib.sha256(DATA).hexdigest()[:8]}.pth"


def _published(server):
    return Published(f"{server.address}{NAME}")


def test_a_file_is_fetched_once(server, tmp_path):
    path = fetch(_published(server), tmp_path)
    assert path.read_bytes() == DATA
    assert fetch(_published(server), tmp_path) == path
    assert server.starts == [0]


def test_a_connection_that_is_cut_is_continued(server, tmp_path):
    server.most = 300_000
    assert fetch(_published(server), tmp_path).read_bytes() == DATA
    assert server.starts == [0, 300_000, 600_000, 900_000]


def test_a_later_call_goes_on_where_an_earlier_one_gave_up(server, tmp_path):
    server.most = 100_000
    with pytest.raises(InvalidRequest) as caught:
        fetch(_published(server), tmp_path)
    assert caught.value.field == "target.name"
    assert str(tmp_path / NAME) in caught.value.detail
    server.most = len(DATA)
    assert fetch(_published(server), tmp_path).read_bytes() == DATA
    assert server.starts == [*(100_000 * k for k in range(ATTEMPTS)), 100_000 * ATTEMPTS]


def test_a_server_without_ranges_sends_all_again(server, tmp_path):
    (tmp_path / f"{NAME}.part").write_bytes(DATA[:1000])
    server.ranges = False
    assert fetch(_published(server), tmp_path).read_bytes() == DATA


def test_a_complete_part_is_taken(server, tmp_path):
    (tmp_path / f"{NAME}.part").write_bytes(DATA)
    assert fetch(_published(server), tmp_path).read_bytes() == DATA


def test_another_file_is_refused_and_not_kept(server, tmp_path):
    server.data = b"no weights"
    with pytest.raises(InvalidRequest, match="does not begin with"):
        fetch(_published(server), tmp_path)
    assert not (tmp_path / NAME).exists()
    assert not (tmp_path / f"{NAME}.part").exists()


def test_a_file_put_there_by_hand_is_checked(server, tmp_path):
    (tmp_path / NAME).write_bytes(b"another")
    with pytest.raises(InvalidRequest, match="is not the file of"):
        fetch(_published(server), tmp_path)
    assert server.starts == []


def test_without_a_network_the_error_says_where_to_put_the_file(tmp_path):
    with pytest.raises(InvalidRequest) as caught:
        fetch(Published(f"http://127.0.0.1:9/{NAME}"), tmp_path)
    assert caught.value.field == "target.name"
    assert f"put the file at {tmp_path / NAME}" in caught.value.detail
