import pytest
from pydantic import ValidationError

from scene_attack_service.settings import Settings

pytestmark = pytest.mark.slow


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


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("data", "~nobody-of-this-name/x", "there is no such user"),
        ("cache", "~nobody-of-this-name/x", "there is no such user"),
        ("database_url", "sqlite://", "a database in memory is lost with its process"),
        ("database_url", "sqlite:///:memory:", "a database in memory is lost with its process"),
    ],
)
def test_a_place_that_cannot_keep_anything_is_refused(name: str, value: str, said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Settings.model_validate({name: value})
    assert Settings.model_validate({"data": "~/x", "database_url": "sqlite:////tmp/jobs.sqlite"})
