"""A service that has keys, and the callers that ask it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import httpx
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts

from scene_attack.runs.campaign_spec import parse as parse_campaign
from scene_attack.runs.spec import parse
from scene_attack.scenes.bundle import Bundle
from scene_attack_api.authentication import scope_of
from scene_attack_api.main import create_app
from scene_attack_api.requests import Services
from scene_attack_service.access.caller import Caller, Scope
from scene_attack_service.jobs.models import CampaignState, State
from scene_attack_service.settings import DEFAULTS
from tests.dashboard_pages import NO_PAGES

SPHERE = {"camera": {"size": [32, 32]}, "objects": [{"mesh": "primitive/sphere"}]}
ATTACK = {"renderer": "pyrender", "steps": 1, "queries": 20}
CAMPAIGN = {"grids": [{"scenes": [SPHERE], "attacks": [{"name": "a", "attack": ATTACK}]}]}
_IDS = ("{job_id}", "{campaign_id}", "{sha256}")
UPLOAD = Bundle("off", b"OFF\n4 4 0\n0 0 0\n5 0 0\n0 6 0\n0 0 7\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n", {})
MESH = UPLOAD.sha256
"""The digits of an upload of alice's."""


def routes(app: FastAPI) -> list[str]:
    """Method and path of every route, in the schema or not; HEAD as GET."""
    found = set()
    for route in iter_route_contexts(app.router.routes):
        assert route.path is not None
        for method in route.methods or {"?"}:
            found.add(f"{'GET' if method == 'HEAD' else method} {route.path}")
    return sorted(found)


ROUTES = {route: scope_of(*route.split(" ")) for route in routes(create_app(DEFAULTS))}
"""Method and path of every route, and the scope that it needs."""
CLOSED = {route: scope for route, scope in ROUTES.items() if scope is not None}
"""The routes that need a key, and their scopes."""
PAGES = [route for route in CLOSED if not NO_PAGES.match(route.partition(" ")[2])]
"""Those among them that a person sees in a browser."""
OWNED = [route for route in CLOSED if any(part in route for part in _IDS)]
"""The routes to what one owner has."""


ALICE = Caller("alice", frozenset(), "")


@dataclass(frozen=True)
class Guarded:
    """A service that has keys: a client without one, the headers of each kind of caller, and what alice has."""

    services: Services
    client: httpx.Client
    headers: dict[str, dict[str, str]]
    job: str
    campaign: str

    def ask(self, route: str, caller: str, *, exists: bool = True) -> httpx.Response:
        """The answer to a request for a route ("GET /v1/jobs/{job_id}"), of what alice has or of nothing."""
        method, path = self.place(route, exists=exists)
        return self.client.request(method, path, headers=self.headers[caller])

    def place(self, route: str, *, exists: bool = True) -> tuple[str, str]:
        """The method and path of a route, of what alice has or of nothing."""
        method, path = route.split(" ")
        names = {"job_id": self.job, "campaign_id": self.campaign, "sha256": MESH}
        names = names if exists else dict.fromkeys(names, "x")
        path = path.replace(":path}", "}")
        return method, path.format(
            name="original.png", path="style.css", asset="primitive/sphere", move="pause", **names
        )

    def untouched(self) -> bool:
        """Whether alice's job, campaign and upload are as they were."""
        job = self.services.record.jobs.line(self.job)
        campaign = self.services.record.campaigns.get(self.campaign)
        assert job is not None
        assert campaign is not None
        assert self.services.assets.visible(ALICE)(f"sha256:{MESH}")
        return (job.state, campaign.state) == (State.QUEUED, CampaignState.SELECTING)


@contextmanager
def guarding(app: FastAPI, client: httpx.Client) -> Iterator[Guarded]:
    """Makes keys for an app that is served, and what alice has, which nobody may touch."""
    services = app.state.services
    assert isinstance(services, Services)
    job, _ = services.record.jobs.create(
        parse({"scene": SPHERE, "attack": ATTACK}), 9, None, lambda _: {}, owner="alice"
    )
    assert job is not None
    headers = {"none": {}, "unknown": bearer("sa_0123456789_" + "x" * 43)}
    for name, owner, scopes, seconds in [
        ("admin", "root", {Scope.ADMIN}, None),
        ("alice", "alice", set(Scope) - {Scope.ADMIN}, None),
        ("bob", "bob", set(Scope) - {Scope.ADMIN}, None),
        ("revoked", "alice", {Scope.ADMIN}, None),
        ("expired", "alice", {Scope.ADMIN}, 0.0),
        *((f"only {scope}", "alice", {scope}, None) for scope in Scope),
        *((f"not {scope}", "alice", set(Scope) - {scope, Scope.ADMIN}, None) for scope in Scope),
    ]:
        key, text = services.keys.create(name, owner, scopes, seconds)
        headers[name] = bearer(text)
        if name == "revoked":
            services.keys.revoke(key.prefix)
    headers["not a bearer"] = {"authorization": headers["admin"]["authorization"].replace("Bearer", "Basic")}
    campaign = services.record.campaigns.submit(parse_campaign(CAMPAIGN), None, "alice")
    services.assets.add("alice", f"sha256:{MESH}", 1)
    services.library.add(UPLOAD)
    services.library.keep_thumbnail(f"sha256:{MESH}", b"PNG")
    guarded = Guarded(services, client, headers, job.id, campaign.id)
    yield guarded
    assert guarded.untouched()


def bearer(text: str) -> dict[str, str]:
    return {"authorization": f"Bearer {text}"}
