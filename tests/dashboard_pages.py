"""The list of the dashboard's pages, which the accessibility test walks and a test compares with the routes."""

import re

PAGES: dict[str, str] = {
    "/": "/",
    "/jobs/{job_id}": "/jobs/{job_id}",
    "/new": "/new",
    "/compare": "/compare?jobs={job_id},{job_id}",
    "/compare/campaigns": "/compare/campaigns?campaigns={campaign_id},{campaign_id}",
    "/campaigns": "/campaigns",
    "/campaigns/{campaign_id}": "/campaigns/{campaign_id}",
    "/assets": "/assets",
    "/assets/{asset:path}": "/assets/primitive/sphere",
    "/targets": "/targets",
    "/docs": "/docs",
    "/sign-in": "/sign-in",
}
"""The path of each route to a page, and an address of it with something on it. The accessibility test fills in
`job_id` and `campaign_id`, which have ended. A new page is added here.
"""
ELSEWHERE: dict[str, str] = {"nothing": "/nothing", "job-of-groups": "/jobs/{groups_id}"}
"""Further addresses, by name: one that no route has, and a job whose page has all that several groups bring."""
NO_PAGES = re.compile(
    r"/(v1|parts|static|new/choices\.json|healthz|readyz|metrics|assets/(?:pictures|scenes)|openapi\.json)(/|$)"
)
"""The beginnings of paths that answer programs, or scripts of pages."""
