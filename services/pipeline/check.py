"""Checks a request as far as that needs neither torch nor a file: its names, and the size and meshes of a campaign.

What else must be right of a job, or of one job of each kind in a campaign (`samples`), is checked where it is prepared.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from services.errors import InvalidFields, InvalidRequest
from services.pipeline.campaign_plan import job_of
from services.pipeline.campaign_spec import CampaignSpec, Grid, Member, SceneGrid
from services.pipeline.campaign_spec import parse as parse_campaign
from services.pipeline.result import JobWarning
from services.pipeline.spec import JobSpec
from services.pipeline.spec import parse as parse_job
from services.rendering.torch_renderer.declaration import check_preset
from services.scenes.description import Lights, Scene
from services.scenes.library import Library
from services.strict import Names
from services.targets.download import check_obtainable


@dataclass(frozen=True)
class Checked:
    """A request that can run: its spec as it would run, and what its sender is warned of."""

    spec: JobSpec
    warnings: tuple[JobWarning, ...]


def names_in(
    library: Library,
    may_use: Callable[[str], bool] = lambda _: True,
    not_read: Mapping[str, str] = MappingProxyType({}),
) -> Names:
    """Returns the context with which a request is validated together with the names in it.

    An upload for whose name `may_use` is false is unknown. `not_read` says of meshes that are files of this machine why
    they could not be added.
    """

    def check_mesh(name: str) -> None:
        if name in not_read:
            raise InvalidRequest("mesh", not_read[name])
        library.check_mesh(name, may_use)

    # A campaign names the same few things in each of thousands of jobs.
    return {
        "mesh": cache(check_mesh),
        "map": cache(lambda name: library.check_map(name, may_use)),
        "material": check_preset,
        "target": cache(check_obtainable),
    }


def check_names(request: JobSpec | CampaignSpec, names: Names) -> None:
    """Raises InvalidFields with every name in a valid request that there is not."""
    parse = parse_job if isinstance(request, JobSpec) else parse_campaign
    parse(request.model_dump(mode="json"), names)


def check_meshes(scene: Scene, check: Callable[[str], None]) -> None:
    """Calls `check` with the name of every mesh, and of an environment map that is an upload. It raises
    InvalidRequest("mesh") for one that may not be named, which is raised again with its path in the request.
    """
    for index, thing in enumerate(scene.objects):
        try:
            check(thing.mesh)
        except InvalidRequest as error:
            raise InvalidRequest(f"scene.objects.{index}.mesh", error.detail) from error
    environment = scene.lights.environment.map
    if environment.startswith("sha256:"):
        try:
            check(environment)
        except InvalidRequest as error:
            detail = f"there is no environment map {environment!r}, or it is no upload of yours"
            raise InvalidRequest("scene.lights.environment.map", detail) from error


Places = Mapping[str, str]
"""The path in the campaign of each part of a job, e.g. {"attack": "grids.0.attacks.2.attack"}; "" is the rest."""


def most_jobs(campaign: CampaignSpec) -> int:
    """The largest number of jobs that the campaign may have; `selection.most` limits it, other rules do not."""
    total = len(campaign.jobs)
    for grid in campaign.grids:
        scenes = grid.count()
        if grid.selection.most is not None:
            scenes = min(scenes, grid.selection.most)
        total += scenes * len(grid.targets) * len(grid.attacks) * len(grid.seeds)
    return total


MOST_JOBS = 10_000
"""Largest campaign, in jobs and in views: days of work for many processes, and a page that a browser still shows."""


def check_size(campaign: CampaignSpec, limit: int = MOST_JOBS) -> None:
    """Raises InvalidRequest if the campaign may have more than `limit` jobs, or has more than `limit` views.

    Counts without making the scenes.
    """
    count = most_jobs(campaign)
    if count > limit:
        raise InvalidRequest(
            "grids" if campaign.grids else "jobs",
            f"the campaign may have {count:,} jobs, and the limit is {limit:,}; list fewer scenes, attacks or "
            "seeds, or set selection.most",
        )
    asked = sum(grid.count() * len(grid.targets) * _renderers(grid) for grid in campaign.grids) + len(campaign.jobs)
    if asked > limit:
        raise InvalidRequest(
            "grids",
            f"the campaign asks the networks for {asked:,} views, and the limit is {limit:,}; list fewer scenes",
        )


def _renderers(grid: Grid) -> int:
    return len({column.attack.base_renderer or column.attack.renderer for column in grid.attacks})


def check_campaign_meshes(campaign: CampaignSpec, check: Callable[[str], None]) -> None:
    """Calls `check` with the name of every mesh. It raises InvalidRequest("mesh") for an unknown one, which is raised
    again with the path of the mesh in the campaign.
    """
    checked = set()
    for name, field in _meshes(campaign):
        if name not in checked:
            checked.add(name)
            try:
                check(name)
            except InvalidRequest as error:
                raise InvalidRequest(field, error.detail) from error


def meshes_of(campaign: CampaignSpec) -> frozenset[str]:
    """The names of all meshes of the campaign."""
    return frozenset(name for name, _ in _meshes(campaign))


def _meshes(campaign: CampaignSpec) -> Iterator[tuple[str, str]]:
    for g, grid in enumerate(campaign.grids):
        if isinstance(grid.scenes, SceneGrid):
            listed = {name: f"meshes.{m}" for m, name in reversed(list(enumerate(grid.scenes.meshes)))}
            for name in grid.scenes.mesh_names():
                yield name, f"grids.{g}.scenes.{listed.get(name, 'kinds')}"
            yield from _map(grid.scenes.lights, f"grids.{g}.scenes")
            continue
        for s, scene in enumerate(grid.scenes or ()):
            yield from _map(scene.lights, f"grids.{g}.scenes.{s}")
            for k, thing in enumerate(scene.objects):
                yield thing.mesh, f"grids.{g}.scenes.{s}.objects.{k}.mesh"
    for j, job in enumerate(campaign.jobs):
        yield from _map(job.scene.lights, f"jobs.{j}.scene")
        for k, thing in enumerate(job.scene.objects):
            yield thing.mesh, f"jobs.{j}.scene.objects.{k}.mesh"


def _map(lights: Lights, place: str) -> Iterator[tuple[str, str]]:
    """The environment map of a scene if it is an upload, and its place."""
    if lights.environment.map.startswith("sha256:"):
        yield lights.environment.map, f"{place}.lights.environment.map"


def samples(campaign: CampaignSpec) -> Iterator[tuple[JobSpec, Places]]:
    """A job for each target, renderer and method of a grid, on its first scene, and every kind of single job once.

    With each come the places of its parts in the campaign, for `placed`.
    """
    for g, grid in enumerate(campaign.grids):
        member = _sample(grid, f"grids.{g}")
        seen = set()
        for t, target in enumerate(grid.targets):
            for c, column in enumerate(grid.attacks):
                job = job_of(grid, member, target, column.attack)
                if _kind(job) not in seen:
                    seen.add(_kind(job))
                    yield job, _places(grid, f"grids.{g}", t, c)
    seen = set()
    for j, job in enumerate(campaign.jobs):
        if _kind(job) not in seen:
            seen.add(_kind(job))
            yield job, {"": f"jobs.{j}"}


def _kind(job: JobSpec) -> tuple[object, ...]:
    """Returns the parts of a job on which a check depends, other than its scene, steps and rates."""
    attack = job.attack
    limits = str(attack.bounds), attack.objective, attack.groups
    return job.target.name, attack.renderer, attack.base_renderer, attack.method, *limits


def _sample(grid: Grid, place: str) -> Member:
    try:
        return grid.sample()
    except InvalidRequest as error:
        raise InvalidRequest(f"{place}.{error.field}", error.detail) from error


def _places(grid: Grid, place: str, target: int, column: int) -> dict[str, str]:
    return {
        **_places_of_scene(grid, place),
        "target": f"{place}.targets.{target}",
        "attack": f"{place}.attacks.{column}.attack",
        "": place,
    }


def _places_of_scene(grid: Grid, place: str) -> dict[str, str]:
    if grid.generate is not None:
        return dict.fromkeys(("scene", "record", "target.question"), f"{place}.generate")
    scenes = f"{place}.scenes"
    if not isinstance(grid.scenes, SceneGrid):
        return {"scene": f"{scenes}.0"}
    return {
        "scene.objects.0.mesh": f"{scenes}.meshes",
        "scene.objects.0.material": f"{scenes}.material",
        "scene.objects.0": f"{scenes}.camera",
        "scene": scenes,
    }


def check_samples(campaign: CampaignSpec, check: Callable[[JobSpec], object]) -> None:
    """Calls `check` with each of the `samples`. Raises its InvalidRequest with the field's path in the campaign."""
    for job, places in samples(campaign):
        try:
            check(job)
        except InvalidRequest as error:
            raise placed(error, places) from error


def placed(error: InvalidRequest, places: Places) -> InvalidRequest:
    """The errors of a job with the paths that their fields have in the campaign."""
    return InvalidFields([_placed(part, places) for part in error.every])


def _placed(error: InvalidRequest, places: Places) -> InvalidRequest:
    field = error.field
    for part, place in places.items():
        if part == "" or field == part or field.startswith(f"{part}."):
            rest = field.removeprefix(part).removeprefix(".")
            return InvalidRequest(f"{place}.{rest}" if rest else place, error.detail)
    return error
