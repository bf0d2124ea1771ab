"""The dashboard: pages made here, from the same record as the API; nothing is loaded from elsewhere."""

from api.dashboard.routes import router

__all__ = ["router"]
