"""`merlfit inspect`: a result in tables and pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import typer

from ...merl_io.atomic import WriteError
from ...merl_io.source import is_regular
from ..pipeline.draws import NoPicture, chain_file
from ..results.schema import Result
from ..results.storage import read_result
from ..support.kept import loaded_ahead
from ..support.outputs import refuse_others
from ..support.terminal import BAD_INPUT, console, fail, note, writable_folder
from . import style
from .pictures import PICTURES, usual
from .subject import Subject, subject_of
from .terminal_tables import beside_table, pictures_table, print_result

FORMATS = ("png", "pdf", "svg")
NOTHING: Mapping[str, Sequence[float]] = {}


def inspect_result(
    result: Path, file: Path | None, out: Path | None, pictures: str | None, kind: str,
    force: bool = False, titled: bool = False, beside: Mapping[str, Sequence[float]] = NOTHING,
) -> None:  # fmt: skip
    """Print a result and write its pictures; exits with 2 where the file that was asked for cannot be drawn.

    Args:
        pictures: names with commas between; "none" for the numbers alone. force: write over any file. titled: say above
            pictures what they are of. beside: values by name, one or one for each channel, to compare the fit's with;
            then pictures only where they are asked for.
    """
    read = read_result(result)
    if beside:
        print_beside(read, result, beside)
        if pictures is None:
            return None
    if pictures == "none":
        return None if beside else print_result(console, read)
    only = [] if pictures is None else [name.strip() for name in pictures.split(",")]
    for name in only:
        if name not in PICTURES:
            raise fail(f"--pictures {name}: no such picture; there are {', '.join(PICTURES)}, or none")
    if kind not in FORMATS:
        raise fail(f"--format {kind}: should be png, pdf or svg")
    found = file or file_of(result, read)
    if not show(result, read, found, out or result.parent, kind, only, file is not None, force, titled):
        raise typer.Exit(BAD_INPUT)


def print_beside(result: Result, path: Path, values: Mapping[str, Sequence[float]]) -> None:
    """Print values from elsewhere beside the fit's intervals."""
    names, given = [q.name for q in result.parameters], {}
    for name, each in values.items():
        own = [q.name for q in result.parameters if name in (q.name, q.parameter)]
        if not own or len(each) not in (1, len(own)):
            needed = f"one value or {len(own)}" if own else f"a parameter of this fit: {', '.join(names)}"
            raise fail(f"--beside {name}: should be {needed}")
        given |= dict(zip(own, list(each) * (len(own) // len(each)), strict=True))
    shares, together = {}, ""
    if any(q.quantiles for q in result.parameters):
        try:
            chain = chain_file(result, path)
        except NoPicture as error:
            note(f"without the chain only intervals are compared: {error}")
        else:
            free = [name for name in given if result.parameters[names.index(name)].fitted != "fixed"]
            draws, weights = chain["values"][:, [names.index(name) for name in free]], chain["weights"]
            point = np.array([given[name] for name in free])
            shares = dict(zip(free, (weights @ (draws < point)).tolist(), strict=True))
            together = _together(draws, weights, point) if len(free) > 1 else ""
    console.print(beside_table(result, given, shares))
    if together:
        console.print(together)


def _together(draws: np.ndarray, weights: np.ndarray, point: np.ndarray) -> str:
    """How far from the middle of the posterior values are together, by the Mahalanobis distance, in words."""
    middle, spread = weights @ draws, np.cov(draws.T, aweights=weights)
    inverse = np.linalg.pinv(spread)
    far = np.einsum("np,pq,nq->n", draws - middle, inverse, draws - middle)
    own = (point - middle) @ inverse @ (point - middle)
    return (
        f"all of them together are farther from the middle than {weights @ (far < own):.1%} of the posterior "
        "(Mahalanobis distance)"
    )


def file_of(path: Path, result: Result) -> Path:
    """The MERL file of a result: as it was named, seen from here, from a folder above the result or from where it ran.

    A project may have moved as a whole.
    """
    named = Path(result.source.path)
    places = [named, *(folder / named for folder in path.absolute().parents), path.parent / named.name]
    if result.run.folder is not None:
        places.append(Path(result.run.folder) / named)
    return next((place for place in places if is_regular(place)), named)


def show(
    path: Path, result: Result, file: Path, out: Path, kind: str = "png", only: Sequence[str] = (),
    needs_file: bool = False, force: bool = False, titled: bool = False,
) -> bool:  # fmt: skip
    """Print and draw.

    Args:
        kind: format of the pictures, png, pdf or svg. only: names of pictures; all by default.
        needs_file: whether it is bad input if the MERL file is of no use. force: write over any file.
        titled: say above pictures what they are of.

    Returns:
        False if the file is of no use and was asked for, or nothing could be drawn.
    """
    print_result(console, result)
    if result.model is None:
        note(f"nothing to draw: the fit ended {result.fit.status}")
        return True
    writable_folder(out)
    m, sampled = result.model, result.posterior is not None
    of = "inspect", m.name, sorted(m.settings.items()), result.source.format, sampled, sorted(only)
    with loaded_ahead(repr(of)):
        return _drawn(path, result, file, out, kind, only, needs_file, force, titled)


def _drawn(
    path: Path, result: Result, file: Path, out: Path, kind: str, only: Sequence[str], needs_file: bool, force: bool,
    titled: bool,
) -> bool:  # fmt: skip
    subject = replace(subject_of(result, path, file), titled=titled)
    if "measurement" in subject.lacks:
        mend = "; name the file with --file" if subject.scattered is None else ""
        note(f"the file is not shown: {subject.lacks['measurement']}{mend}")
    drawn = draw(subject, out, kind, only or usual(subject), force)
    if drawn:
        console.print(pictures_table(drawn))
    else:
        note("nothing was drawn")
    return bool(drawn) and (subject.lacks.get("measurement") is None or subject.scattered is not None or not needs_file)


def draw(subject: Subject, out: Path, kind: str, names: Sequence[str], force: bool = False) -> dict[Path, str]:
    """Write pictures; what each written one shows. What cannot be drawn is named."""
    edited = ".edited" if subject.result.edited_from else ""  # in one folder each model and material has its own
    stem = f"{subject.result.source.material}{edited}.{subject.model.name}"
    targets, written, missing = {name: out / f"{stem}.{name}.{kind}" for name in names}, {}, {}
    refuse_others(targets.values(), force)
    for name, target in targets.items():
        try:
            style.save(PICTURES[name].draw(subject), target)
        except NoPicture as error:
            missing.setdefault(str(error), []).append(name)
            continue
        except WriteError:
            raise
        except Exception as error:  # of any kind, text that was edited into what is no formula say
            note(f"{target}: cannot be drawn ({type(error).__name__}: {str(error).strip()})")
            continue
        written[target] = PICTURES[name].words
    for why, those in missing.items():
        reason = "they need the file" if why == subject.lacks.get("measurement") else why
        note(f"not drawn: {', '.join(those)} ({reason})")
    return written
