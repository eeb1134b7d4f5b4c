"""The state behind every front-end of the live view: what it is told of the results, and what it may ask.

A front-end (`page/view.js`) shows what `Live.about` says and asks by messages, plain dictionaries, for frames, for what
effects cost, and to save and export what was edited; it waits for one answer before it asks again, and then asks for
the newest only. A message that cannot be answered is answered by ``error``, in words.
"""

import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from threading import Lock
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from ..pipeline.editing import edited, edited_file
from ..pipeline.place import claimed
from ..results.schema import ParameterResult
from ..results.storage import write_result
from ..results.strict import FileName, Strict
from ..settings.config import ConfigError
from ..show.curves import part_name
from ..show.style import channel_colour, letters
from ..support.compilation import make_room
from ..support.terminal import why_ended
from .discs import pictures
from .frames import TOLERANCE, Look, Shown

STEEPEST_DEG = 85.0  # of the light whose lobe is shown
EXPORT_S = 300.0


class _Asked(Strict):
    result: Annotated[int, Field(ge=0)]
    values: dict[str, float]
    """Of free parameters, by name; the others are as fitted."""


class FrameAsked(_Asked):
    """Pictures and lobes."""

    ask: Literal["frame"]
    off: list[str] = []  # noqa: RUF012 - pydantic copies it
    theta_i: Annotated[float, Field(ge=0, le=STEEPEST_DEG)]
    exposure: Annotated[float, Field(ge=-10, le=10)]
    moving: bool


class CostsAsked(_Asked):
    """What each effect changes and costs."""

    ask: Literal["costs"]


class SaveAsked(_Asked):
    """To write what was edited, as a result."""

    ask: Literal["save"]
    name: Annotated[FileName, Field(pattern=r"^[^.-]")]
    """Neither hidden nor like an option of a command."""


class ExportAsked(Strict):
    """To write a saved result for another program."""

    ask: Literal["export"]
    result: Annotated[int, Field(ge=0)]
    path: str
    to: str


_ASKED = TypeAdapter(Annotated[FrameAsked | CostsAsked | SaveAsked | ExportAsked, Field(discriminator="ask")])


class Live:
    """Results that are looked at, side by side.

    Args:
        shown: what is looked at. folder: for what is saved, that of each result by default. exports: formats of
            `merlfit export`.
    """

    def __init__(self, shown: Sequence[Shown], folder: Path | None = None, exports: Sequence[str] = ()) -> None:
        self.shown, self.folder, self.exports = tuple(shown), folder, tuple(exports)
        self._saved: set[Path] = set()
        self._exposures: dict[int, float] = {}  # of each file's spheres, as they were last sent
        self._lock = Lock()

    @property
    def about(self) -> dict[str, Any]:
        """What front-ends are told once."""
        results = [_about(each, self._free_name(each)) for each in self.shown]
        return {"results": results, "exports": self.exports, "steepest": STEEPEST_DEG, "tolerance": TOLERANCE}

    def answer(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """What is asked for, with ``answer`` and ``result`` as the message had them; ``error`` where it cannot be."""
        head, path = {"answer": message.get("ask"), "result": message.get("result")}, self.shown[0].path
        try:
            asked = _ASKED.validate_python(dict(message))
            if asked.result >= len(self.shown):
                raise ConfigError(f"there is no result {asked.result}")
            each = self.shown[asked.result]
            path = each.path
            match asked:
                case FrameAsked():
                    return head | self._frame(each, asked)
                case CostsAsked():
                    return head | self._costs(each, each.numbers(asked.values))
                case SaveAsked():
                    return head | self._save(each, asked)
                case ExportAsked():
                    return head | self._export(asked)
        except ValidationError as error:
            first = error.errors()[0]
            return head | {"error": f"{'.'.join(map(str, first['loc']))}: {first['msg']}"}
        except Exception as error:  # of any kind: the view goes on
            return head | {"error": why_ended(path, error)}

    def _frame(self, each: Shown, asked: FrameAsked) -> dict[str, Any]:
        if unknown := set(asked.off) - {effect.name for effect in each.effects}:
            raise ConfigError(f"there is no effect {min(unknown)}")
        look = Look(each.numbers(asked.values), tuple(sorted(asked.off)), asked.moving)
        start = time.perf_counter()
        with self._lock:
            radiance, dims = each.radiance(look), each.dims(look.moving)
            found: dict[str, Any] = {
                "pictures": pictures(radiance, dims, asked.exposure, asked.moving), "file": None, "apart": None,
                "lobe": each.lobe(look, asked.theta_i), "moving": asked.moving,
            }  # fmt: skip
            # which looks the same while parameters move, but not while the exposure does
            if each.measured and not (asked.moving and self._exposures.get(asked.result) == asked.exposure):
                found["file"] = pictures(each.measured, each.dims(False), asked.exposure, False)
                self._exposures[asked.result] = asked.exposure
            if not asked.moving:
                found["apart"] = each.apart(radiance)
        return found | {"ms": round(1e3 * (time.perf_counter() - start), 1)}

    def _costs(self, each: Shown, values: tuple[float, ...]) -> dict[str, Any]:
        make_room()
        rows, planned, slow = each.tried(values, self._lock)
        with self._lock:
            each.planned = planned
        costs = {
            row.effect.name: {
                "kept": row.kept, "off_by": round(row.alone, 3), "saves": round(row.nanoseconds / slow, 3),
            }
            for row in rows
        }  # fmt: skip
        return {"costs": costs, "nanoseconds": round(slow)}

    def _save(self, each: Shown, asked: SaveAsked) -> dict[str, Any]:
        path = self._folder(each) / f"{asked.name.removesuffix('.json')}.json"
        found = edited(each.path, each.result, each.changes(asked.values))
        if found is each.result:
            raise ConfigError("nothing was changed: there is nothing to save")
        with claimed(path.parent, alone=False):
            if path.exists():
                raise ConfigError(f"{path}: is there already; give it another name")
            write_result(path, found)
        self._saved.add(path)
        return {"path": str(path), "name": self._free_name(each), "said": found.edited_words}

    def _export(self, asked: ExportAsked) -> dict[str, Any]:
        """By the command itself, whose words are the answer."""
        path = Path(asked.path)
        if path not in self._saved or asked.to not in self.exports:
            raise ConfigError(f"{path} --to {asked.to}: save first, and choose a format")
        command = [sys.executable, "-m", "merlfit", "export", path, "--to", asked.to, "-o", path.parent / "exported"]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=EXPORT_S)
        if done.returncode:
            raise ConfigError(" ".join(done.stderr.split()) or f"merlfit export ended with {done.returncode}")
        return {"said": " ".join(done.stdout.split())}

    def _folder(self, each: Shown) -> Path:
        return self.folder or each.path.parent

    def _free_name(self, each: Shown) -> str:
        """A name that nothing has in the folder."""
        stem, k = edited_file(each.path).stem, 1
        while (self._folder(each) / f"{stem}{f'-{k}' if k > 1 else ''}.json").exists():
            k += 1
        return f"{stem}{f'-{k}' if k > 1 else ''}"


def _about(each: Shown, name: str) -> dict[str, Any]:
    """Of one result."""
    result, model = each.result, each.model
    scales = {q.name: q for q in model.measured.parameters}
    return {
        "name": result.source.material, "path": str(each.path), "model": model.name, "data": result.data_words,
        "error": result.error_words, "save_as": name, "before": "as opened" if result.edited_from else "as fitted",
        "file": each.subject.lacks.get("measurement"), "scattered": each.subject.scattered is not None,
        "channels": [{"name": c, "colour": channel_colour(c, k)} for k, c in enumerate(model.channels)],
        "parameters": [
            {
                "name": q.name, "parameter": q.parameter, "symbol": letters(q.symbol), "channel": q.channel,
                "meaning": q.meaning, "unit": "" if q.unit == "1" else q.unit.replace("um", "µm"), "value": q.value,
                "lower": q.lower, "upper": q.upper, "log": scales[q.parameter].scale == "log",
                "offset": scales[q.parameter].offset, **_interval(q),
            }
            for q in result.parameters
            if q.fitted == "free"
        ],
        "fixed": [f"{q.name} = {q.value:.4g} ({q.fitted})" for q in result.parameters if q.fitted != "free"],
        "effects": [
            {"name": e.name, "words": part_name(e.lobe) if e.lobe else e.name, "instead": e.instead}
            for e in each.effects
        ],
    }  # fmt: skip


def _interval(q: ParameterResult) -> dict[str, Any]:
    """The 90 % interval of a number, and where it is from; None where there is none."""
    found, words = (q.quantiles, "posterior") if q.quantiles else (q.laplace, "Laplace approximation")
    return {"interval": [found.q05, found.q95] if found else None, "interval_of": words if found else None}
