"""The OpenAPI document as YAML, and its operations as a page of the docs.

`python -m scene_attack_api.openapi > openapi.yaml`; `python -m scene_attack_api.openapi page > docs/reference/api.md`
"""

import sys
from collections.abc import Iterator
from typing import Any

import yaml

from scene_attack.runs.set_up import set_up
from scene_attack_api.main import create_app
from scene_attack_service.settings import DEFAULTS

HEAD = """# Operations of the HTTP API

A command writes this page from `openapi.yaml`, which also has the fields of every answer. [The service](../service.md)
says how to use the API, and what all answers and errors have in common."""


def document() -> str:
    """The OpenAPI document of the API as YAML."""
    return yaml.safe_dump(_schema(), sort_keys=False, allow_unicode=True, width=120)


def page() -> str:
    """The operations as Markdown, a section for each tag."""
    schema = _schema()
    lines = [HEAD, ""]
    for tag in schema["tags"]:
        lines += [f"## {tag['name'].capitalize()}", "", tag["description"], ""]
        for path, operations in schema["paths"].items():
            for method, operation in operations.items():
                if operation["tags"] == [tag["name"]]:
                    lines += [f"### `{method.upper()} {path}`", "", *_section(operation)]
    return "\n".join(lines).rstrip() + "\n"


def _section(operation: dict[str, Any]) -> Iterator[str]:
    yield from (operation["description"], "")
    scopes = [scope for security in operation.get("security", []) for scope in security["key"]]
    facts = [f"operation `{operation['operationId']}`", f"scope `{scopes[0]}`" if scopes else "no key needed"]
    facts += [
        f"body `{kind}`, `{media['schema']['$ref'].rpartition('/')[2]}`"
        for kind, media in operation.get("requestBody", {}).get("content", {}).items()
    ]
    yield from (f"{'; '.join(facts)}; status {', '.join(sorted(operation['responses']))}.", "")
    parameters = [parameter for parameter in operation.get("parameters", []) if parameter["in"] != "path"]
    if parameters:
        yield from ("| parameter | in | meaning |", "|---|---|---|")
        for parameter in parameters:
            yield f"| `{parameter['name']}` | {parameter['in']} | {parameter.get('description', '')} |"
        yield ""


def _schema() -> dict[str, Any]:
    return create_app(DEFAULTS).openapi()


if __name__ == "__main__":
    set_up(DEFAULTS)  # loads the plug-ins, whose fields are served
    sys.stdout.write(page() if sys.argv[1:] == ["page"] else document())
