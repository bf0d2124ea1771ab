"""Routes that give out a whole list of jobs as a file."""

import csv
import io
import json
import re
from collections.abc import Iterator
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query
from fastapi.responses import StreamingResponse
from pydantic import AfterValidator, WithJsonSchema

from scene_attack.client.schemas import JobRow, JobTable
from scene_attack_api.cursors import NEWEST
from scene_attack_api.requests import CallerDependency, Services, ServicesDependency
from scene_attack_api.routes.jobs import QueryText, Sort
from scene_attack_service.access.caller import Caller
from scene_attack_service.jobs.job_list import ListedJob, Term, parse_query

AT_ONCE = 500
"""Jobs that are read from the database at once."""


def _job_id(text: str) -> str:
    if not re.fullmatch("[0-9a-f]{32}", text):
        raise ValueError("it is no id of a job, which has 32 hexadecimal digits")
    return text


JobId = Annotated[str, AfterValidator(_job_id), WithJsonSchema({"type": "string", "pattern": "^[0-9a-f]{32}$"})]
Ticked = Annotated[list[JobId] | None, Query(max_length=200, description="ids of jobs, if only these are wanted")]

router = APIRouter(prefix="/v1", tags=["jobs"])


COLUMNS = tuple(JobRow.model_fields)


def job_rows(
    services: ServicesDependency,
    caller: CallerDependency,
    q: QueryText = None,
    sort: Sort = NEWEST,
    job: Ticked = None,
) -> Iterator[dict[str, Any]]:
    """The lines of the table, in the order of `sort`: the caller's jobs that meet the query, of `job` if it is given.

    Raises InvalidRequest("q").
    """
    terms = parse_query(q or "")
    return _jobs(services, caller, [*terms, *([] if job is None else [Term("id", "=", tuple(job))])], sort)


JobRows = Annotated[Iterator[dict[str, Any]], Depends(job_rows)]


@router.get(
    "/jobs.csv",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}}},
)
def get_job_table_csv(rows: JobRows) -> StreamingResponse:
    """Every job that meets a query, as a table with one line each. p is a number, not in thousandths."""
    return _file(_csv_lines(rows), "text/csv; charset=utf-8", "jobs.csv")


@router.get("/jobs.json", response_class=StreamingResponse, responses={200: {"model": JobTable}})
def get_job_table(rows: JobRows) -> StreamingResponse:
    """Every job that meets a query, with the columns of the table."""
    return _file(_json_lines(rows), "application/json", "jobs.json")


def _file(lines: Iterator[str], media_type: str, name: str) -> StreamingResponse:
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-store"}
    return StreamingResponse(lines, headers=headers, media_type=media_type)


def _jobs(services: Services, caller: Caller, terms: list[Term], sort: str) -> Iterator[dict[str, Any]]:
    after = None
    while True:
        page = services.record.lists.page(terms, AT_ONCE, sort=sort, after=after, owner=caller.only)
        yield from map(_flat, page.jobs)
        if not page.more_after:
            return
        after = page.last


def _flat(job: ListedJob) -> dict[str, Any]:
    outcome = job.outcome or {}
    values = {
        "outcome": job.verdict,
        "before": outcome.get("before"),
        "after": outcome.get("after"),
        "state": job.state.value,
        "tags": job.tags or [],
        "campaign": job.campaign_id,
        "created": job.created_at.isoformat(),
        "ended": None if job.ended_at is None else job.ended_at.isoformat(),
    }
    return {name: values[name] if name in values else getattr(job, name) for name in COLUMNS}


def _csv_lines(jobs: Iterator[dict[str, Any]]) -> Iterator[str]:
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    writer.writerow(COLUMNS)
    for job in jobs:
        writer.writerow(_cell(job[name]) for name in COLUMNS)
        if buffer.tell() > 2**16:
            yield _taken(buffer)
    yield _taken(buffer)


def _cell(value: Any) -> Any:
    text = " ".join(value) if isinstance(value, list) else value
    # A spreadsheet would run a text that begins so as a formula.
    return f"'{text}" if isinstance(text, str) and text.lstrip()[:1] in ("=", "+", "-", "@") else text


def _json_lines(jobs: Iterator[dict[str, Any]]) -> Iterator[str]:
    yield '{"items": ['
    for number, job in enumerate(jobs):
        yield (",\n" if number else "\n") + json.dumps(job, ensure_ascii=False)
    yield "\n]}\n"


def _taken(buffer: io.StringIO) -> str:
    text = buffer.getvalue()
    buffer.seek(0)
    buffer.truncate()
    return text
