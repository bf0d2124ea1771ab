"""Makes analyses of a stored result, as the worker makes those that a request asks for."""

from pathlib import Path

from pydantic import BaseModel

from services.analysis.attribution import of_subsets
from services.analysis.records import Analyses, Attribution, Subset
from services.analysis.requests import AnalysisRequest
from services.analysis.subsets import scored, subsets
from services.errors import InvalidRequest
from services.pipeline.analyse import Report, Subject, analyse
from services.pipeline.prepare import prepare
from services.pipeline.spec import JobSpec, parse
from services.pipeline.stored import read_stored
from services.rendering.protocol import Parameters
from services.scenes.library import Library


class StoredAnalysis(BaseModel):
    """The table of subsets and the groups' Shapley values, made anew, and the analyses that were asked for."""

    subsets: list[Subset]
    attribution: Attribution
    analyses: Analyses


def analyse_stored(directory: Path, request: AnalysisRequest, library: Library, report: Report) -> StoredAnalysis:
    """Analyses the result in a directory. Raises InvalidRequest as `read_stored` and `prepare` do, and if a
    file does not belong to the others.
    """
    stored = read_stored(directory)
    spec = parse(stored.result.spec | {"analysis": request.model_dump(mode="json")})
    prepared = prepare(spec, library)
    verifier = prepared.verifier
    _check(stored.perturbation, spec, prepared.renderer.initial())
    perturbation = {group: stored.perturbation[group] for group in spec.attack.groups}  # in the order of tables
    ends = scored(verifier, {}), scored(verifier, perturbation)
    rows = subsets(verifier, prepared.goal, perturbation, *ends)
    found = analyse(Subject(prepared, perturbation, *ends), request, library, report)
    return StoredAnalysis(subsets=rows, attribution=of_subsets(rows), analyses=found)


def _check(perturbation: Parameters, spec: JobSpec, initial: Parameters) -> None:
    """Raises InvalidRequest("directory") if the perturbation is not one of the scene and the groups of the spec."""
    wanted = {group: list(initial[group].shape) for group in spec.attack.groups}
    found = {group: list(value.shape) for group, value in perturbation.items()}
    if found != wanted:
        detail = f"its perturbation has the groups and shapes {found}, which are not {wanted} of its request"
        raise InvalidRequest("directory", detail)
