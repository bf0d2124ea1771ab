import pytest

from services.errors import JobFailure
from services.jobs import preflight_process
from services.jobs.child import OUT_OF_MEMORY
from services.jobs.preflight_process import answer
from tests.unit.jobs.small import LIBRARY, spec


@pytest.mark.parametrize("error", [MemoryError(), JobFailure("out-of-memory", "the driver refused")])
def test_a_request_that_can_never_fit_memory_is_answered_so(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def refuse(*_: object) -> None:
        raise error

    monkeypatch.setattr(preflight_process, "preflight", refuse)
    assert answer({"check": spec().model_dump(mode="json")}, LIBRARY) == OUT_OF_MEMORY
