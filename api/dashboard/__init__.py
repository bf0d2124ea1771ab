"""The dashboard: HTML pages made from the same record as the API, which load nothing from other sites."""

from fastapi import APIRouter

from api.dashboard import (
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
router.include_router(job_list.router)
router.include_router(comparison.router)
router.include_router(job_page.router)
router.include_router(new_job.router)
router.include_router(campaigns.router)
router.include_router(assets.router)
router.include_router(targets.router)
router.include_router(reference.router)
router.include_router(sign_in.router)
