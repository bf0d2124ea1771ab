"""Makes analyses of a stored result, as the worker makes those that a request asks for."""

from pathlib import Path

from pydantic import BaseModel

from services.analysis.attribution import of_subsets
from services.analysis.records import Analyses, Attribution, Subset
from services.analysis.requests import AnalysisRequest
from services.analysis.subsets import scored, subsets
from services.pipeline.analyse import Report, Subject, analyse
from services.pipeline.prepare import prepare
from services.pipeline.spec import parse
from services.pipeline.stored import read_stored
from services.scenes.library import Library


class StoredAnalysis(BaseModel):
    """The table of subsets and the groups' Shapley values, made anew, and the analyses that were asked for."""

    subsets: list[Subset]
    attribution: Attribution
    analyses: Analyses


def analyse_stored(directory: Path, request: AnalysisRequest, library: Library, report: Report) -> StoredAnalysis:
    """Analyses the result in a directory. Raises InvalidRequest as `read_stored` and `prepare` do."""
    stored = read_stored(directory)
    spec = parse(stored.result.spec | {"analysis": request.model_dump(mode="json")})
    prepared = prepare(spec, library)
    verifier = prepared.verifier
    perturbation = {group: stored.perturbation[group] for group in spec.attack.groups}  # in the order of tables
    ends = scored(verifier, {}), scored(verifier, perturbation)
    rows = subsets(verifier, prepared.goal, perturbation, *ends)
    found = analyse(Subject(prepared, perturbation, *ends), request, library, report)
    return StoredAnalysis(subsets=rows, attribution=of_subsets(rows), analyses=found)
