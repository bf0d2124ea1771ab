"""What a finished job gives away: its scenes as glTF, its light, its parameters, and a report, in one folder or zip."""

BUNDLE = "bundle"
"""What the process that makes exports is asked for: everything, in one zip file."""
ASSET = "asset"
"""A request for the scene of one asset."""
