from pathlib import Path

import pytest

from services.errors import JobFailure
from services.jobs import warm_process
from services.jobs.child import OUT_OF_MEMORY
from services.jobs.files import ArtifactStore
from services.jobs.warm_process import answer
from tests.unit.jobs.small import LIBRARY, spec


@pytest.mark.parametrize("error", [MemoryError(), JobFailure("out-of-memory", "the driver refused")])
def test_a_request_that_can_never_fit_memory_is_answered_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
) -> None:
    def refuse(*_: object) -> None:
        raise error

    monkeypatch.setattr(warm_process, "preflight", refuse)
    assert answer({"check": spec().model_dump(mode="json")}, LIBRARY, ArtifactStore(tmp_path)) == OUT_OF_MEMORY
