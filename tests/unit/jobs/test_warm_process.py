from pathlib import Path

import pytest

from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.rendering.plan import Plan
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.runs.execute import execute
from scene_attack.runs.prepare import plan as plan_of_job
from scene_attack_service.jobs import warm_process
from scene_attack_service.jobs.files import ArtifactStore
from scene_attack_service.jobs.processes import OUT_OF_MEMORY
from scene_attack_service.jobs.warm_process import answer
from tests.unit.jobs.small import LIBRARY, spec


@pytest.mark.parametrize("error", [MemoryError(), JobFailure("out-of-memory", "the driver refused")])
def test_a_request_that_can_never_fit_memory_is_answered_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
) -> None:
    def refuse(*_: object) -> None:
        raise error

    monkeypatch.setattr(warm_process, "prepare", refuse)
    assert answer({"check": spec().model_dump(mode="json")}, LIBRARY, ArtifactStore(tmp_path)) == OUT_OF_MEMORY


def test_a_request_whose_plan_cannot_be_made_is_refused_before_it_is_queued(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It was accepted, and refused by its worker: a check accepts what can be planned and run, and nothing else."""

    def plan(_: object) -> Plan:
        raise InvalidRequest("tolerance", "no plan keeps it")

    monkeypatch.setattr(TorchRenderer, "plan", property(plan))
    request = spec({"renderer": "torch"})
    refusal = {"errors": [("tolerance", "no plan keeps it")]}
    assert answer({"check": request.model_dump(mode="json")}, LIBRARY, ArtifactStore(tmp_path)) == refusal
    for run in (lambda: plan_of_job(request, LIBRARY), lambda: execute(request, tmp_path, LIBRARY)):
        with pytest.raises(InvalidRequest, match="tolerance: no plan keeps it"):
            run()
