"""Writes client/answers.pyi, the types of openapi.yaml: `python -m client.write_answers > client/answers.pyi`.

Each schema of openapi.yaml becomes a TypedDict of the same name, an enumeration a Literal. An answer is then plain JSON
at run time, so that a client of one version reads the answers of another, and a checker of types knows every field.
"""

from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import Any

DESCRIPTION = Path(__file__).parent.parent / "openapi.yaml"
HEAD = '''"""The types of openapi.yaml's requests and answers. `python -m client.write_answers` writes this file."""

from typing import Any, Literal, NotRequired, TypedDict
'''
LINE = 120
_PLAIN = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}


def written(description: Mapping[str, Any]) -> str:
    """The module's text for an OpenAPI description."""
    schemas = description["components"]["schemas"]
    return "\n".join([HEAD, *(_definition(name, schema) for name, schema in sorted(schemas.items()))])


def _definition(name: str, schema: Mapping[str, Any]) -> str:
    if "properties" not in schema:
        return f"{name} = {type_of(schema)}\n"
    required = schema.get("required", ())
    fields = {
        field: type_of(one) if field in required else f"NotRequired[{type_of(one)}]"
        for field, one in schema["properties"].items()
    }
    if not all(field.isidentifier() for field in fields):
        listed = ", ".join(f'"{field}": {kind}' for field, kind in fields.items())
        return f'{name} = TypedDict("{name}", {{{listed}}})\n'
    lines = (f"    {field}: {kind}" for field, kind in fields.items())
    return "\n".join([f"class {name}(TypedDict):", *_docstring(schema), *lines, ""])


def _docstring(schema: Mapping[str, Any]) -> list[str]:
    text = str(schema.get("description", "")).replace("\\", "\\\\").replace('"""', "'''")
    if not text:
        return []
    lines = [line for part in text.split("\n\n") for line in [*wrap(" ".join(part.split()), LINE - 11), ""]][:-1]
    if len(lines) == 1:
        return [f'    """{lines[0]}"""']
    return [f'    """{lines[0]}', *(f"    {line}".rstrip() for line in lines[1:]), '    """']


def type_of(schema: Mapping[str, Any]) -> str:
    """The type of a schema, as Python writes it."""
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    for alternatives in ("anyOf", "oneOf"):
        if alternatives in schema:
            return " | ".join(dict.fromkeys(map(type_of, schema[alternatives])))
    if "const" in schema:
        return f"Literal[{schema['const']!r}]"
    if "enum" in schema:
        return f"Literal[{', '.join(map(repr, schema['enum']))}]"
    kind = schema.get("type")
    if kind == "array":
        return f"list[{' | '.join(dict.fromkeys(map(type_of, schema.get('prefixItems', [schema.get('items', {})]))))}]"
    if kind == "object":
        others = schema.get("additionalProperties")
        return f"dict[str, {type_of(others) if isinstance(others, dict) else 'Any'}]"
    return _PLAIN.get(str(kind), "Any")


if __name__ == "__main__":
    import yaml

    print(written(yaml.safe_load(DESCRIPTION.read_text("utf-8"))), end="")
