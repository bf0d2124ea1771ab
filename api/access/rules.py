"""The scope that a caller needs for each route. A route that is not listed here answers nobody but administrators."""

from dataclasses import dataclass
from re import Pattern

from starlette.routing import compile_path

from services.access.caller import Scope

OPEN = None
"""The rule of a route that needs no key."""

_READ, _WRITE, _UPLOAD = Scope.JOBS_READ, Scope.JOBS_WRITE, Scope.ASSETS_WRITE

RULES: dict[str, Scope | None] = {
    # Health, for load balancers; without a key it names no extension and no network
    "GET /healthz": OPEN,
    "GET /readyz": OPEN,
    "GET /metrics": Scope.METRICS_READ,
    # The API
    "POST /v1/jobs": _WRITE,
    "GET /v1/jobs": _READ,
    "GET /v1/jobs.csv": _READ,
    "GET /v1/jobs.json": _READ,
    "GET /v1/jobs/{job_id}": _READ,
    "PATCH /v1/jobs/{job_id}": _WRITE,
    "POST /v1/jobs/{job_id}/cancel": _WRITE,
    "POST /v1/jobs/{job_id}/retry": _WRITE,
    "POST /v1/jobs/{job_id}/continue": _WRITE,
    "DELETE /v1/jobs/{job_id}": _WRITE,
    "GET /v1/jobs/{job_id}/events": _READ,
    "GET /v1/jobs/{job_id}/artifacts": _READ,
    "GET /v1/jobs/{job_id}/artifacts/{name}": _READ,
    "POST /v1/preview": _WRITE,
    "GET /v1/jobs/{job_id}/export": _READ,
    "GET /v1/jobs/{job_id}/scene.glb": _READ,
    "POST /v1/campaigns": _WRITE,
    "GET /v1/campaigns": _READ,
    "GET /v1/campaigns/{campaign_id}": _READ,
    "POST /v1/campaigns/{campaign_id}/pause": _WRITE,
    "POST /v1/campaigns/{campaign_id}/resume": _WRITE,
    "POST /v1/campaigns/{campaign_id}/cancel": _WRITE,
    "GET /v1/campaigns/{campaign_id}/views": _READ,
    "GET /v1/campaigns/{campaign_id}/jobs": _READ,
    "GET /v1/campaigns/{campaign_id}/table.json": _READ,
    "GET /v1/campaigns/{campaign_id}/table.csv": _READ,
    "GET /v1/campaigns/{campaign_id}/table.tex": _READ,
    "GET /v1/campaigns/{campaign_id}/cases.csv": _READ,
    "POST /v1/rerenderings": _WRITE,
    "POST /v1/assets": _UPLOAD,
    "GET /v1/assets": _READ,
    "GET /v1/assets/{sha256}": _READ,
    "GET /v1/assets/{sha256}/thumbnail": _READ,
    "DELETE /v1/assets/{sha256}": _UPLOAD,
    "GET /v1/scenes": _READ,
    "GET /v1/targets": _READ,
    # Its description
    "GET /openapi.json": _READ,
    "GET /docs": _READ,
    # The dashboard
    "GET /": _READ,
    "GET /parts/jobs": _READ,
    "GET /parts/jobs/changes": _READ,
    "POST /jobs/selected": _WRITE,
    "GET /compare": _READ,
    "GET /compare/campaigns": _READ,
    "GET /jobs/{job_id}": _READ,
    "GET /parts/jobs/{job_id}": _READ,
    "POST /jobs/{job_id}/cancel": _WRITE,
    "GET /new": _READ,
    "POST /new": _WRITE,
    "GET /new/choices.json": _READ,
    "POST /jobs/{job_id}/about": _WRITE,
    "POST /jobs/{job_id}/retry": _WRITE,
    "POST /jobs/{job_id}/delete": _WRITE,
    "POST /jobs/{job_id}/continue": _WRITE,
    "GET /campaigns": _READ,
    "GET /parts/campaigns": _READ,
    "GET /campaigns/{campaign_id}": _READ,
    "GET /parts/campaigns/{campaign_id}": _READ,
    "POST /campaigns/{campaign_id}/{move}": _WRITE,
    "GET /assets": _READ,
    "POST /assets": _UPLOAD,
    "GET /assets/pictures/{asset:path}": _READ,
    "GET /assets/scenes/{asset:path}": _READ,
    "GET /assets/{asset:path}": _READ,
    "GET /targets": _READ,
    "GET /static/{path:path}": OPEN,
    "GET /sign-in": OPEN,
    "POST /sign-in": OPEN,
    "POST /sign-out": OPEN,
}
"""The method and path of each route, and its scope. A rule of GET is also that of HEAD."""


PAGES = frozenset(
    {
        "GET /",
        "POST /jobs/selected",
        "GET /compare",
        "GET /compare/campaigns",
        "GET /jobs/{job_id}",
        "POST /jobs/{job_id}/cancel",
        "GET /new",
        "POST /new",
        "POST /jobs/{job_id}/about",
        "POST /jobs/{job_id}/retry",
        "POST /jobs/{job_id}/delete",
        "POST /jobs/{job_id}/continue",
        "GET /campaigns",
        "GET /campaigns/{campaign_id}",
        "GET /assets",
        "POST /assets",
        "GET /assets/{asset:path}",
        "GET /targets",
        "GET /docs",
        "POST /campaigns/{campaign_id}/{move}",
    }
)
"""The routes that send a browser without a session to sign in. The parts of pages answer 401 to the script instead."""


@dataclass(frozen=True)
class Rule:
    """The rule of a route: its method and path, and the scope it needs."""

    route: str
    scope: Scope | None

    @property
    def is_page(self) -> bool:
        """Whether a person sees the answer in a browser."""
        return self.route in PAGES


_COMPILED: list[tuple[str, Pattern[str], Rule]] = [
    (method, compile_path(path)[0], Rule(f"{method} {path}", scope))
    for route, scope in RULES.items()
    for method, path in [route.split(" ")]
]


def rule_of(method: str, path: str) -> Rule | None:
    """The rule of a request; None for a path that is not listed, or not with this method."""
    asked = "GET" if method == "HEAD" else method
    path = path.rstrip("/") or "/"  # the framework redirects a path with a slash at its end to the one without
    return next((rule for of, pattern, rule in _COMPILED if of == asked and pattern.match(path)), None)
