import pytest

from services.settings import Settings


def test_a_child_process_gets_the_same_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    given = Settings(workers=3, redis_url="unix:///tmp/a b.sock", lease_seconds=1.5, gl="osmesa")
    environ = given.environ()
    assert "SCENE_ATTACK_DATABASE_URL" not in environ  # unset is not the word "None"
    for name, value in environ.items():
        monkeypatch.setenv(name, value)
    assert Settings() == given
