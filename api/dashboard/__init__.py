"""The dashboard: HTML pages made from the same record as the API, which load nothing from other sites."""

from api.dashboard.routes import router

__all__ = ["router"]
