from datetime import UTC, datetime, timedelta

import pytest

from scene_attack_api.dashboard import words

NOW = datetime(2030, 1, 1, tzinfo=UTC)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (1.0, "100.0 %"),
        (0.7664, "76.6 %"),
        (0.001, "0.1 %"),
        (0.0000213, "0.0021 %"),
        (0.0, "0.0 %"),
        (3e-12, "3e-10 %"),
    ],
)
def test_percent_never_rounds_something_to_nothing(value: float, said: str) -> None:
    assert words.percent(value).replace("\N{NO-BREAK SPACE}", " ") == said


@pytest.mark.parametrize(
    ("value", "said"), [(4.24, "4.2 s"), (59.96, "60.0 s"), (200.4, "3 min 20 s"), (7500, "2 h 5 min")]
)
def test_seconds(value: float, said: str) -> None:
    assert words.seconds(value).replace("\N{NO-BREAK SPACE}", " ") == said


@pytest.mark.parametrize(("number", "said"), [(0, "0 queries"), (1, "1 query"), (1450, "1,450 queries")])
def test_one_thing_is_no_plural(number: int, said: str) -> None:
    assert words.count(number, "query", "queries").replace("\N{NO-BREAK SPACE}", " ") == said


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"color": 0.0003, "rotation": 0.01}, "color 0.0003, rotation 0.01"),
        (1.5258789279881668e-05, "1.53e-05"),
        ([], "none"),
        (["point 0 x", "point 0 y"], "point 0 x, point 0 y"),
        ({"color": []}, "color none"),
        (12, "12"),
    ],
)
def test_a_measured_setting_is_said_in_words(value: object, said: str) -> None:
    assert words.setting(value) == said


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(-3, "just now"), (59, "just now"), (61, "1 min ago"), (3600 * 5, "5 h ago"), (86400 * 3, "3 days ago")],
)
def test_ago(seconds: float, said: str) -> None:
    assert words.ago(NOW - timedelta(seconds=seconds), NOW) == said


def test_every_kind_of_failure_has_its_sentence() -> None:
    from scene_attack.errors import JobFailure

    kinds = [word.strip('",. ') for word in (JobFailure.__doc__ or "").split() if word.startswith('"')]
    assert kinds
    assert set(kinds) == set(words.FAILURES)


def test_perceptibility_is_in_thousandths() -> None:
    assert words.milli(0.0057) == "5.70"
