"""Routes of the page of a job. A script keeps it up to date; it also works without it.

The page shows what people say about a job (title, tags, note), and its request as commands that send it again.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Form, Request, Response
from fastapi.responses import RedirectResponse

from scene_attack.client.schemas import JobEdit
from scene_attack.runs.result import BEST_SO_FAR
from scene_attack.runs.spec import parsed
from scene_attack_api.dashboard import views
from scene_attack_api.dashboard.pages import HEADERS, STATIC, VERSION, html, part_of
from scene_attack_api.dashboard.views import all_events
from scene_attack_api.requests import CallerDependency, KnownJob, Services, ServicesDependency, no_such
from scene_attack_api.routes.jobs import continued
from scene_attack_service.jobs.files import Damaged, delete_with_files
from scene_attack_service.jobs.models import Artifact, JobKind

router = APIRouter(include_in_schema=False)


_KINDS = {"css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
"""Media types by the end of a name; anything else is text, as licences are."""


@router.get("/jobs/{job_id}")
@router.get("/parts/jobs/{job_id}")
def job(job_id: str, services: ServicesDependency, caller: CallerDependency, request: Request) -> Response:
    """The page of one job."""
    stored = caller.visible(services.record.jobs.get(job_id, with_result=True))
    if stored is None:
        raise no_such("job")
    if stored.kind is JobKind.RERENDERING:
        return html(part_of(request, "rerendering.html"), caller=caller, job=stored)
    events = all_events(services.record, job_id)
    artifacts = services.record.jobs.artifacts(job_id)
    page = views.page(stored, events, artifacts, _best_so_far(services, artifacts))
    retries = services.record.lists.retries(job_id, caller.only)
    sent_again = commands(stored.spec, str(request.base_url).rstrip("/"), with_key=bool(caller.key))
    values: dict[str, Any] = {"job": stored, "page": page, "retries": retries, "commands": sent_again}
    return html(part_of(request, "job.html"), caller=caller, **values)


@router.post("/jobs/{job_id}/cancel")
def cancel(job: KnownJob, services: ServicesDependency) -> Response:
    """Cancels a job, as the button on its page asks, and redirects to the page."""
    services.record.jobs.request_cancel(job.id)
    return _to(f"/jobs/{job.id}")


@router.post("/jobs/{job_id}/continue")
def continue_job(job: KnownJob, services: ServicesDependency, caller: CallerDependency) -> Response:
    """Continues a job that was cancelled or failed, as the button on its page asks, and redirects to the new job."""
    return _to(f"/jobs/{continued(job, services, caller).id}")


@router.get("/static/{path:path}")
def static(path: str) -> Response:
    """Style sheets, scripts and images. Their address begins with a version, so that browsers may cache them."""
    name = path.removeprefix(f"{VERSION}/")
    data = STATIC.get(name)
    if data is None:
        raise no_such("file")
    kept = "no-cache" if name == path else "max-age=31536000, immutable"
    kind = _KINDS.get(name.rpartition(".")[2], "text/plain")
    return Response(data, headers=HEADERS | {"Cache-Control": kept}, media_type=kind)


def _best_so_far(services: Services, artifacts: Sequence[Artifact]) -> dict[str, Any] | None:
    """Best result of a job that ended before its time; None if it has no such file."""
    for artifact in artifacts:
        if artifact.name == BEST_SO_FAR:
            with suppress(FileNotFoundError, Damaged), services.store.open(artifact.sha256) as file:
                best: dict[str, Any] = json.load(file)
                return best
    return None


@router.post("/jobs/{job_id}/about")
def edit(
    job: KnownJob,
    services: ServicesDependency,
    title: Annotated[str, Form()] = "",
    tags: Annotated[str, Form()] = "",
    note: Annotated[str, Form()] = "",
) -> Response:
    """Writes what the form on the page says; the tags have spaces or commas between them."""
    form = {"title": title.strip(), "tags": tags.replace(",", " ").split(), "note": note.replace("\r\n", "\n").strip()}
    services.record.lists.edit(job.id, parsed(JobEdit, form).changes())
    return _to(f"/jobs/{job.id}")


@router.post("/jobs/{job_id}/retry")
def again(job: KnownJob, services: ServicesDependency, caller: CallerDependency) -> Response:
    """Queues the job's request again, and goes to the new job's page."""
    return _to(f"/jobs/{services.submissions.retry(caller, job.id).id}")


@router.post("/jobs/{job_id}/delete")
def delete(job: KnownJob, services: ServicesDependency) -> Response:
    """Deletes a job that has ended, with its files, and goes to the list."""
    delete_with_files(services.record, services.store, job.id)
    return _to("/")


def _to(address: str) -> Response:
    return RedirectResponse(address, 303, HEADERS)


@dataclass(frozen=True)
class Command:
    """A way to send a request: the name of its element on a page, its words, and its text."""

    id: str
    words: str
    text: str


def commands(spec: Mapping[str, Any], address: str, with_key: bool) -> list[Command]:
    """The commands for a service at `address`, which have a key from SCENE_ATTACK_KEY if the service asks for one.

    The request stands in them as JSON of several lines, of which none can end a here-document or a string of Python: no
    line of it is the word JSON alone, and within JSON three quotes never follow each other.
    """
    written = json.dumps(spec, indent=1, ensure_ascii=False)
    key = ' -H "Authorization: Bearer $SCENE_ATTACK_KEY"' if with_key else ""
    imports = "import json\nimport os\n\nimport httpx\n" if with_key else "import json\n\nimport httpx\n"
    headers = ', headers={"Authorization": f"Bearer {os.environ[\'SCENE_ATTACK_KEY\']}"}' if with_key else ""
    document = f"<<'JSON'\n{written}\nJSON\n"
    kind = "-H 'content-type: application/json'"
    return [
        Command("as-cli", "Command line", f"SCENE_ATTACK_URL={address} scene-attack submit --watch - {document}"),
        Command("as-curl", "curl", f"curl -s {address}/v1/jobs {kind}{key} --data-binary @- {document}"),
        Command(
            "as-python",
            "Python",
            f'{imports}\nspec = json.loads(r"""\n{written}\n""")\n'
            f'answer = httpx.post("{address}/v1/jobs", json=spec{headers}, timeout=60)\n'
            'answer.raise_for_status()\nprint(answer.json()["id"], answer.json()["state"])\n',
        ),
    ]
