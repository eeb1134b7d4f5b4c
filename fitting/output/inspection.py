"""`merlfit inspect`: a result in tables and pictures."""

from pathlib import Path

from matplotlib.figure import Figure

from ...merl_io.atomic import WriteError
from ...merl_io.binary import MerlError
from ..results.schema import Result
from ..support.compilation import use_persistent_cache
from ..support.terminal import console, fail, note, writable_folder
from . import plots
from .report import print_result


def file_of(path: Path, result: Result) -> Path:
    """The MERL file of a result: as it was named, seen from here, from a folder above the result or from where it ran.

    A project may have moved as a whole.
    """
    named = Path(result.source.path)
    places = [named, *(folder / named for folder in path.absolute().parents), path.parent / named.name]
    if result.run is not None and result.run.folder is not None:
        places.append(Path(result.run.folder) / named)
    try:
        return next((place for place in places if place.is_file()), named)
    except ValueError:  # a NUL in it, which reading it complains about
        return named


def show(path: Path, result: Result, file: Path, out: Path, needs_file: bool = False) -> bool:
    """Print and draw.

    Args:
        needs_file: whether it is bad input if the MERL file is of no use.

    Returns:
        False if what could have been drawn was not.
    """
    use_persistent_cache()
    print_result(console, result)
    if result.model is None:
        note(f"nothing to draw: the fit ended {result.fit.status}")
        return True
    writable_folder(out)
    drawn = []

    def save(name: str, figure: Figure) -> None:
        target = out / f"{result.source.material}.{name}.png"
        try:
            plots.save(figure, target)
        except WriteError as error:
            raise fail(str(error)) from None
        except ValueError as error:  # text that was edited into what is no formula
            note(f"{target}: cannot be drawn ({str(error).strip().splitlines()[0]})")
            return
        drawn.append(name)
        console.print(f"wrote {target}", soft_wrap=True)

    chain = None
    try:
        drawn_from = plots.chain_file(result, path)
        save("corner", plots.corner_figure(result, drawn_from))
        if result.posterior is not None and result.posterior.sufficient:  # of no other the lobe plot has a band
            chain = drawn_from
    except plots.NoPicture as error:
        note(f"no corner plot: {error}")
    try:
        save("lobes", plots.lobe_figure(result, result.source.read(file), chain))
    except MerlError as error:
        note(f"no lobe plot: {error}; name the file with --file")
    if not drawn:
        note("nothing was drawn")
    return "lobes" in drawn if needs_file else bool(drawn)
