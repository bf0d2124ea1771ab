"""Checks a campaign as far as that needs neither torch nor a file: its size, and a job of each kind (`samples`), whose
errors are named by their place in the campaign.
"""

from collections.abc import Callable, Iterator, Mapping

from scene_attack.errors import InvalidFields, InvalidRequest, below
from scene_attack.runs.campaign_plan import job_of
from scene_attack.runs.campaign_spec import CampaignSpec, Grid, SceneGrid
from scene_attack.runs.spec import JobSpec
from scene_attack.scenes.description import Scene
from scene_attack.scenes.scene_file import upload_of

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


def most_views(campaign: CampaignSpec) -> int:
    """The largest number of views that the campaign may show to networks, without making their scenes."""
    return sum(grid.count() * len(grid.targets) * _renderers(grid) for grid in campaign.grids) + len(campaign.jobs)


MOST_JOBS = 10_000
"""Largest campaign, in jobs and in views: days of work for many processes, and a page that a browser still shows."""
MOST_BYTES = 2_000_000
"""Longest campaign, as JSON with its defaults filled in. Every answer and page about it has it in full."""


def check_size(campaign: CampaignSpec, limit: int = MOST_JOBS) -> None:
    """Raises InvalidRequest if the campaign may have more than `limit` jobs, has more than `limit` views, or is longer
    than `MOST_BYTES`.

    Counts without making the scenes.
    """
    count = most_jobs(campaign)
    if count > limit:
        raise InvalidRequest(
            "grids" if campaign.grids else "jobs",
            f"the campaign may have {count:,} jobs, and the limit is {limit:,}; list fewer scenes, attacks or "
            "seeds, or set selection.most",
        )
    asked = most_views(campaign)
    if asked > limit:
        raise InvalidRequest(
            "grids",
            f"the campaign asks the networks for {asked:,} views, and the limit is {limit:,}; list fewer scenes",
        )
    written = len(campaign.model_dump_json())
    if written > MOST_BYTES:
        raise InvalidRequest(
            "grids" if campaign.grids else "jobs",
            f"with its defaults filled in, the campaign takes {written / 1e6:.1f} MB, and the limit is "
            f"{MOST_BYTES / 1e6:g} MB; make scenes and jobs by grids in place of listing them",
        )


def _renderers(grid: Grid) -> int:
    return len({column.attack.base_renderer or column.attack.renderer for column in grid.attacks})


def uploads_in(campaign: CampaignSpec) -> dict[str, str]:
    """The uploads that a campaign names, meshes and environment maps, each with the path where it is named first."""
    places: dict[str, str] = {}
    for g, grid in enumerate(campaign.grids):
        if isinstance(grid.scenes, SceneGrid):
            for m, name in enumerate(grid.scenes.meshes):
                places.setdefault(name, f"grids.{g}.scenes.meshes.{m}")
            places.setdefault(grid.scenes.lights.environment.map, f"grids.{g}.scenes.lights.environment.map")
            continue
        for s, scene in enumerate(grid.scenes or ()):
            _add_names(places, scene, f"grids.{g}.scenes.{s}")
    for j, job in enumerate(campaign.jobs):
        _add_names(places, job.scene, f"jobs.{j}.scene")
    uploads: dict[str, str] = {}
    for name, place in places.items():
        if name.startswith("sha256:"):
            uploads.setdefault(upload_of(name), place)
    return uploads


def _add_names(places: dict[str, str], scene: Scene, place: str) -> None:
    places.setdefault(scene.lights.environment.map, f"{place}.lights.environment.map")
    for part, things in (("objects", scene.objects), ("fixed", scene.fixed)):
        for k, thing in enumerate(things):
            places.setdefault(thing.mesh, f"{place}.{part}.{k}.mesh")


def samples(campaign: CampaignSpec) -> Iterator[tuple[JobSpec, Places]]:
    """A job for each target, renderer and method of a grid, on its first scene, and every kind of single job once.

    With each come the places of its parts in the campaign, for `placed`.
    """
    for g, grid in enumerate(campaign.grids):
        with below(f"grids.{g}"):
            member = grid.sample()
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


def _places(grid: Grid, place: str, target: int, column: int) -> dict[str, str]:
    return {
        **_places_of_scene(grid, place),
        "target": f"{place}.targets.{target}",
        "attack": f"{place}.attacks.{column}.attack",
        "": place,
    }


def _places_of_scene(grid: Grid, place: str) -> dict[str, str]:
    if grid.generate is not None:
        return dict.fromkeys(("scene", "target.ask"), f"{place}.generate")
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
            # what `generate` makes has fields that it has not
            rest = "" if place.endswith(".generate") else field.removeprefix(part).removeprefix(".")
            return InvalidRequest(f"{place}.{rest}" if rest else place, error.detail)
    return error
