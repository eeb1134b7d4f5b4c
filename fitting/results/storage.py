"""Results as JSON: read, validated and written atomically."""

import codecs
import json
import math
import os
import platform
import re
from importlib import metadata
from pathlib import Path

from pydantic import BaseModel, ValidationError

from ...merl_io.atomic import write_text
from ...merl_io.inputs import SCATTERED
from ...merl_io.source import MerlError, whole
from ..settings.config import Config
from .schema import BY_HAND, SCHEMA_VERSION, Result

PACKAGES = ("merlfit", "jax", "jaxlib", "numpy", "scipy", "equinox", "emcee", "arviz-stats")

MEASURED = (".binary", *SCATTERED)  # endings of files that are fitted
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
    ours = found.edited_from is None and not found.changed_by_hand
    return found if ours and same == (sha1, config.plain(), versions()) else None


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
    if result.changed_by_hand and BY_HAND not in result.fit.cautions:
        result.fit.cautions.append(BY_HAND)
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
