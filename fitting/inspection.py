"""`merlfit inspect`: a result in tables and pictures."""

from pathlib import Path

from ..merl_io.binary import MerlError, read
from . import plots
from .compilation import use_persistent_cache
from .export import Result
from .report import print_result
from .terminal import console, errors, fail, writable_folder


def show(path: Path, result: Result, file: Path, out: Path) -> bool:
    """Print and draw; whether the MERL file was of use."""
    use_persistent_cache()
    print_result(console, result)
    writable_folder(out)
    pictures, chain = {}, None
    try:
        chain = plots.chain_file(result, path.parent)
        pictures["corner"] = plots.corner_figure(result, chain)
    except plots.NoPicture as error:
        errors.print(f"merlfit: no corner plot: {error}", markup=False, soft_wrap=True)
    try:
        measurement = read(file, result.source.sha1)
        if result.model is not None:
            pictures["lobes"] = plots.lobe_figure(result, measurement, chain)
    except MerlError as error:
        errors.print(f"merlfit: no lobe plot: {error}; name the file with --file", markup=False, soft_wrap=True)
    for name, figure in pictures.items():
        target = out / f"{result.source.material}.{name}.png"
        try:
            plots.save(figure, target)
        except OSError as error:
            raise fail(f"{target}: cannot be written ({error.strerror or error})") from None
        console.print(f"wrote {target}", markup=False, soft_wrap=True)
    return "lobes" in pictures or result.model is None
