"""Exports of finished jobs: scenes as glTF, light, parameters and a report, in one folder or zip file."""

BUNDLE = "bundle"
"""Request to the process that makes exports for everything, in one zip file."""
ASSET = "asset"
"""A request for the scene of one asset."""
