"""One file to fit: all that it takes to do that in any process, and what came of it."""

import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ...merl_io.atomic import WriteError
from ...merl_io.binary import MerlError
from ...model.two_scale import TwoScale
from ..pipeline.place import place_of
from ..pipeline.run import Finish, Found, fit_file
from ..results.manifest import Ending
from ..results.schema import Result
from ..results.storage import ResultError, read_result
from ..settings.config import Config
from ..support.clock import Report, silent
from ..support.compilation import FIRST_FIT, FIRST_RIVAL, make_room, programs_told
from ..support.outputs import log, log_of
from ..support.terminal import Stopped, why_ended


@dataclass(frozen=True)
class Unit:
    """A file, the folder for its result, the settings, and a fit of it; as `pipeline.run.fit_file` takes them."""

    path: Path
    out: Path
    settings: Config
    finish: Finish | None = None
    found: Found | None = None

    @property
    def name(self) -> str:
        """Name of the material, and of its files."""
        return self.path.stem

    @property
    def target(self) -> Path:
        """Where the result is to be."""
        return self.out / f"{self.name}.json"

    @property
    def log(self) -> Path:
        """What was done when, and what libraries said in the meantime."""
        return log_of(self.out, self.name)


@dataclass(frozen=True)
class Ended:
    """What came of a unit.

    Attributes:
        result: what was written, None if nothing was. error: one line that says why there is none.
        said: of results that lie beside others. code: what to exit with, of one that was stopped.
    """

    kind: Ending
    result: Result | None = None
    error: str = ""
    said: str = ""
    code: int = 0


Task = Callable[[Unit, Report], Ended]


def fit_unit(unit: Unit, report: Report = silent) -> Ended:
    """Fit the file and write its result; whatever it runs into is in what is returned.

    A stop ends the fit where it is: what is computed so far is on disk, the chain of an unfinished posterior, too.
    """
    place = None
    try:
        make_room()
        if not unit.out.is_dir():
            raise WriteError(f"{unit.out}: is there no more; make it again, and go on with --resume")
        with place_of(unit.out, unit.name) as place:
            of = FIRST_FIT if unit.settings.model.name == TwoScale.name else FIRST_RIVAL
            with programs_told(_logged(unit, report), of) as told:
                result = fit_file(unit.path, place.folder, unit.settings, told, unit.finish, unit.found)
        log(unit.log, f"{result.fit.status}, {result.seconds['total']:.1f} s")
        ended = Ended(Ending.FITTED, result)
    except MerlError as error:
        ended = Ended(Ending.BAD_INPUT, error=str(error))
    except WriteError as error:  # names the output, the input is not to blame
        ended = Ended(Ending.FAILED, error=str(error))
    except Stopped as stop:
        ended = Ended(Ending.STOPPED, code=stop.code)
        if place is not None and place.written:
            with suppress(ResultError):  # it may have been taken away
                ended = replace(ended, result=read_result(place.path))
    except Exception as error:  # of any kind: said with its name, and the next file has its turn
        log(unit.log, traceback.format_exc())
        where = str(error) if place is None else str(error).replace(str(place.folder), str(place.path.parent))
        ended = Ended(Ending.FAILED, error=why_ended(unit.path, error, where))
    return replace(ended, said=place.said) if place is not None else ended


def _logged(unit: Unit, report: Report) -> Report:
    """Reports whose stages, without every step, are also written to the log."""
    last = [""]

    def reported(stage: str) -> None:
        if (begun := stage.split(":")[0]) != last[0]:
            last[0] = begun
            log(unit.log, stage)
        report(stage)

    return reported
