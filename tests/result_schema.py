"""The JSON Schema that the package ships, from the classes of a result: `python -m tests.result_schema` writes it."""

import ast
import json
import re
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, get_origin, get_type_hints

from merlfit.fitting.results.schema import SCHEMA_VERSION, Model, Result
from merlfit.fitting.settings.choice import Choice
from merlfit.model.apparatus import Apparatus
from merlfit.model.effects import ANY
from merlfit.model.registry import models
from merlfit.model.two_scale import TwoScale
from pydantic import TypeAdapter

PARTS = Path(__file__).parents[1] / "fitting" / "results"


def schema():
    """JSON Schema of a result; the package ships it as ``fitting/results/result.schema.json``."""
    found = Result.model_json_schema(mode="serialization")
    kinds = models()
    for kind in kinds.values():
        found["$defs"][kind.__name__] = {**TypeAdapter(kind).json_schema(), "additionalProperties": False}
    described = _below_fields() | {kind.__name__: _attributes(kind) for kind in (*kinds.values(), Apparatus, Choice)}
    for kind, part in {**found["$defs"], Result.__name__: found}.items():
        for name, field in part["properties"].items():
            field["description"] = described[kind][name]
    found["$defs"][TwoScale.__name__]["properties"]["body"]["enum"].remove(ANY)
    model = found["$defs"][Model.__name__]
    model["properties"]["name"]["enum"] = list(kinds)
    model["oneOf"] = [
        {"properties": {"name": {"const": name}, "settings": {"$ref": f"#/$defs/{kind.__name__}"}}}
        for name, kind in kinds.items()
    ]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"merlfit/result-{SCHEMA_VERSION}",
        **found,
    }


def _below_fields():
    """Descriptions by class and field from the strings below the fields of the parts.

    Pydantic would read them, too (``use_attribute_docstrings``), but at every import, which takes a tenth of a second.
    """
    found = {}
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PARTS.glob("*.py"))]
    for kind in (node for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)):
        for field, below in pairwise(kind.body):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(below, ast.Expr)
                and isinstance(below.value, ast.Constant)
            ):
                said = " ".join(str(below.value.value).split())
                found.setdefault(kind.name, {})[ast.unparse(field.target)] = said
    return found


def _attributes(kind):
    """Descriptions by attribute from the docstrings of a class and of those that it inherits from."""
    names, found = [name for name, hint in get_type_hints(kind).items() if get_origin(hint) is not ClassVar], {}
    for each in reversed(kind.__mro__) if names else ():
        listed = (each.__dict__.get("__doc__") or "").partition("Attributes:")[2].partition("\n\n")[0]
        text = re.sub(r":[a-z]+:`([^`]+)`", r"\1", " ".join(listed.split()))
        parts = re.split(rf"\b({'|'.join(names)}): ", text)
        found |= dict(zip(parts[1::2], map(str.strip, parts[2::2]), strict=True))
    return found


if __name__ == "__main__":  # `make schema`
    (PARTS / "result.schema.json").write_text(json.dumps(schema(), indent=2) + "\n")
