"""The dashboard: HTML pages made from the same record as the API, which load nothing from other sites."""

from fastapi import APIRouter

from scene_attack_api.dashboard import (
    assets,
    campaigns,
    comparison,
    job_list,
    job_page,
    new_job,
    reference,
    sign_in,
    targets,
)

__all__ = ["router"]

router = APIRouter()
for part in (job_list, comparison, job_page, new_job, campaigns, assets, targets, reference, sign_in):
    router.include_router(part.router)
