"""`merlfit sample`: its progress, and what it says."""

import traceback
from pathlib import Path

import typer

from ..pipeline.place import claimed
from ..pipeline.resampling import resample
from ..results.storage import read_result
from ..show.inspection import file_of
from ..show.terminal_tables import print_result
from ..support.compilation import programs_told, use_persistent_cache
from ..support.outputs import log, log_of
from ..support.terminal import FAILED_FIT, Stopped, console, fail, note, reporting


def sample_result(result: Path, file: Path | None, max_steps: int | None) -> None:
    """Sample the posterior of a result, and print it; exits with 1 if the chain is too short still."""
    use_persistent_cache()
    try:
        read = read_result(result)
        with claimed(result.parent), reporting(result.name, read.source.material) as say, programs_told(say) as told:
            found = resample(result, read, file or file_of(result, read), max_steps, told)
    except RuntimeError as error:
        where = log_of(result.parent, result.stem)
        log(where, traceback.format_exc())
        fail(f"{error}; {result} is as it was, {where} says where it failed")
        raise typer.Exit(FAILED_FIT) from None
    except Stopped as stop:
        note(f"stopped by {stop}: {result} is as it was; `merlfit sample {result}` continues the chain so far")
        raise typer.Exit(stop.code) from None
    print_result(console, found)
    if found.posterior is not None and not found.posterior.sufficient:
        raise typer.Exit(FAILED_FIT)
