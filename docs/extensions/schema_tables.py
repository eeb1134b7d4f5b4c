"""The directive ``{schema}``: the JSON Schema of results as tables, a section for each part, every field described."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

Schema = Mapping[str, Any]


class Tables(SphinxDirective):
    """Markdown made of the schema, parsed where the directive stands."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The sections of all parts."""
        path = Path(self.env.relfn2path(self.arguments[0])[1])
        self.env.note_dependency(str(path))
        found = nodes.Element()
        self.state.nested_parse(StringList(list(page(json.loads(path.read_text()))), str(path)), 0, found)
        return found.children


def page(schema: Schema) -> Iterator[str]:
    """Lines of Markdown: the result itself, then its parts in the schema's order."""
    for name, part in {"Result": schema, **schema["$defs"]}.items():
        yield from (f"(schema-{name})=", f"## {name}", "", _said(part), "")
        if fields := part.get("properties"):
            yield from ("| field | type | what |", "|---|---|---|")
            needed = part.get("required", ())
            yield from (_row(key, field, key in needed) for key, field in fields.items())
            yield ""


def _row(key: str, field: Schema, needed: bool) -> str:
    type_of = _type(field).replace("|", "\\|")
    return f"| `{key}` | {type_of}{'' if needed else ', optional'} | {_said(field)} |"


def _said(part: Schema) -> str:
    return " ".join(part.get("description", "").replace("``", "`").replace("|", "\\|").split())


def _type(field: Schema) -> str:
    if "$ref" in field:
        name = field["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#schema-{name})"
    if "anyOf" in field or "oneOf" in field:
        return " or ".join(_type(kind) for kind in field.get("anyOf", field.get("oneOf")))
    if "const" in field:
        return f"`{json.dumps(field['const'])}`"
    if "enum" in field:
        return " or ".join(f"`{json.dumps(value)}`" for value in field["enum"])
    if field.get("type") == "array":
        return f"list of {_type(field.get('items', {}))}"
    if field.get("type") == "object" and isinstance(field.get("additionalProperties"), dict):
        return f"object of {_type(field['additionalProperties'])}"
    return field.get("type", "anything")


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_directive("schema", Tables)
    return {"parallel_read_safe": True}
