"""Results as JSON: read, validated and written atomically; the schema that the package ships."""

import ast
import codecs
import json
import math
import os
import platform
import re
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, get_origin, get_type_hints

from pydantic import BaseModel, TypeAdapter, ValidationError

from ...merl_io.atomic import write_text
from ...merl_io.source import MerlError, whole
from ...model.apparatus import Apparatus
from ...model.effects import ANY
from ...model.registry import models
from ...model.two_scale import TwoScale
from ..settings.choice import Choice
from ..settings.config import Config
from .schema import EDITED, SCHEMA_VERSION, Model, Result

PACKAGES = ("merlfit", "jax", "jaxlib", "numpy", "scipy", "equinox", "lineax", "optimistix", "emcee", "arviz-stats")

MEASURED = (".binary", ".bsdf", ".csv", ".npz")  # endings of files that are fitted
LARGEST = 2**26  # bytes of a result: one of a hundred channels has a thirtieth of that


class ResultError(MerlError):
    """A result file that cannot be used; the message is one line that names the file."""


def versions() -> dict[str, str]:
    """Versions of what computed the numbers."""
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in PACKAGES}}


def finite(x: float) -> float | None:
    """The number, or None (null in JSON) where it is not finite."""
    return float(x) if math.isfinite(x) else None


def write_result(path: Path, result: Result) -> None:
    """Write JSON, atomically; numbers that are not finite are refused, since JSON has none.

    Raises:
        merlfit.merl_io.atomic.WriteError: it cannot be written.
    """
    text = json.dumps(result.model_dump(mode="json"), indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    write_text(path, text)


def valid_result(path: Path, sha1: str, config: Config) -> Result | None:
    """A result that is there already, if it is of the same data, settings and versions."""
    try:
        found = read_result(path)
    except ResultError:
        return None
    same = found.source.sha1, found.config, found.versions
    return found if not found.edited and same == (sha1, config.plain(), versions()) else None


class _Versioned(BaseModel):
    schema_version: str


def read_result(path: str | os.PathLike[str]) -> Result:
    """Read and validate a result.

    Raises:
        ResultError: missing, not JSON, not a result, of a schema version that this program does not know, or with
            numbers, names or lists that no fit writes.
    """
    path = Path(path)
    try:
        text = whole(path, ResultError, LARGEST).removeprefix(codecs.BOM_UTF8)
        _check_version(path, _Versioned.model_validate_json(text).schema_version)
        result = Result.model_validate_json(text)
    except ValidationError as error:
        if path.suffix.lower() in MEASURED:
            raise ResultError(f"{path}: is a measured file, not a result: fit it first, merlfit fit {path}") from None
        raise ResultError(f"{path}: is not a merlfit result: {_in_words(error)}") from None
    if result.edited and EDITED not in result.fit.cautions:
        result.fit.cautions.append(EDITED)
    return result


def _check_version(path: Path, version: str) -> None:
    if version == SCHEMA_VERSION:
        return
    if not re.fullmatch(r"\d{1,9}\.\d{1,9}", version, re.ASCII):
        raise ResultError(f"{path}: is not a merlfit result: schema_version {version[:40]!r} is not {SCHEMA_VERSION}")
    its, ours = ([int(part) for part in each.split(".")] for each in (version, SCHEMA_VERSION))
    age, mend = ("a newer", "update merlfit") if its > ours else ("an older", "fit the file again")
    raise ResultError(
        f"{path}: was written by {age} merlfit (schema {version}, this one reads {SCHEMA_VERSION}): {mend}"
    )


SAID = {
    "missing": "is missing",
    "extra_forbidden": "is no field of a result",
    "finite_number": "is not a finite number",
}


def _in_words(error: ValidationError) -> str:
    """The first thing that is wrong, and where."""
    first = error.errors()[0]
    said = first["msg"].removeprefix("Value error, ")
    if first["type"] == "json_invalid":
        return said.replace("Invalid JSON", "it is not JSON")
    said = SAID.get(first["type"], said.replace("Input should be", "should be"))
    where = ".".join(map(str, first["loc"]))
    return f"{where}: {said}" if where else said


def schema() -> dict[str, Any]:
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


def _below_fields() -> dict[str, dict[str, str]]:
    """Descriptions by class and field from the strings below the fields of the parts.

    Pydantic would read them, too (``use_attribute_docstrings``), but at every import, which takes a tenth of a second.
    """
    found: dict[str, dict[str, str]] = {}
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in sorted(Path(__file__).parent.glob("*.py"))]
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


def _attributes(kind: type) -> dict[str, str]:
    """Descriptions by attribute from the docstrings of a class and of those that it inherits from."""
    names, found = [name for name, hint in get_type_hints(kind).items() if get_origin(hint) is not ClassVar], {}
    for each in reversed(kind.__mro__) if names else ():
        listed = (each.__dict__.get("__doc__") or "").partition("Attributes:")[2].partition("\n\n")[0]
        text = re.sub(r":[a-z]+:`([^`]+)`", r"\1", " ".join(listed.split()))
        parts = re.split(rf"\b({'|'.join(names)}): ", text)
        found |= dict(zip(parts[1::2], map(str.strip, parts[2::2]), strict=True))
    return found


if __name__ == "__main__":  # `make schema`
    target = Path(__file__).with_name("result.schema.json")
    target.write_text(json.dumps(schema(), indent=2) + "\n")
