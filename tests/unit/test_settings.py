import pytest

from services.settings import Settings


def test_a_child_process_gets_the_same_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    given = Settings(workers=3, redis_url="unix:///tmp/a b.sock", lease_seconds=1.5, gl="osmesa")
    environ = given.environ()
    assert "SCENE_ATTACK_DATABASE_URL" not in environ  # unset is not the word "None"
    for name, value in environ.items():
        monkeypatch.setenv(name, value)
    assert Settings() == given


def test_an_empty_variable_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """An unset variable in a unit or a compose file is an empty one; an empty path would be the working directory."""
    for name in ("DATA", "PORT", "DATABASE_URL"):
        monkeypatch.setenv(f"SCENE_ATTACK_{name}", "")
    for name in ("data", "port", "database_url"):
        assert getattr(Settings(), name) == Settings.model_fields[name].default
