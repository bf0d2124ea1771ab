"""The OpenAPI document as YAML: `python -m api.openapi > openapi.yaml`."""

import sys

import yaml

from api.main import create_app
from services.settings import DEFAULTS


def document() -> str:
    """The OpenAPI document of the API as YAML."""
    schema = create_app(DEFAULTS).openapi()
    return yaml.safe_dump(schema, sort_keys=False, allow_unicode=True, width=120)


if __name__ == "__main__":
    sys.stdout.write(document())
