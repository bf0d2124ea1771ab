"""The HTTP clients of a running service, and the schemas of its answers."""

DEFAULT_URL = "http://127.0.0.1:8008"
"""The service of this machine."""
