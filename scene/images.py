"""Image files: EXR of radiance, PNG for screens, and environment maps; through OpenEXR, OpenImageIO and Pillow."""

import importlib.util
import io
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import IO

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from ..merl_io.atomic import write_atomically
from ..merl_io.source import opened
from .colour import displayed
from .description import SceneError

LARGEST = 2**27  # numbers of a map: 8192 x 4096 pixels of four channels
NEGATIVE = 1e-3  # of all light: filters that resize a map leave a little below 0, which is taken for 0
BRIGHTEST = float(np.finfo(np.float32).max)  # of a map: pictures are made in single precision


def write_exr(path: Path, radiance: np.ndarray) -> None:
    """Linear RGB (H, W, 3) as floats of 32 bits, atomically.

    Raises:
        merlfit.merl_io.atomic.WriteError: it cannot be written.
    """
    import OpenEXR  # a quarter of a second that only pictures are worth

    image = np.ascontiguousarray(radiance, np.float32)

    def write(file: IO[bytes]) -> None:
        try:
            with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "software": "merlfit"}, {"RGB": image}) as exr:
                exr.write(file.name)  # by its name: the library opens it itself
        except RuntimeError as error:  # which is how the library says what the system said
            raise OSError(str(error)) from None

    write_atomically(path, write)


def write_png(path: Path, radiance: np.ndarray) -> None:
    """Linear RGB (H, W, 3) over white as a screen shows it, or (H, W, 3) of 8 bits as it is, atomically.

    Raises:
        merlfit.merl_io.atomic.WriteError: it cannot be written.
    """
    image = radiance if radiance.dtype == np.uint8 else displayed(radiance)
    made_by = PngInfo()
    made_by.add_text("Software", "merlfit")
    write_atomically(path, lambda file: Image.fromarray(image).save(file, "PNG", optimize=True, pnginfo=made_by))


def read_map(path: Path) -> np.ndarray:
    """An environment's radiance (H, W, 3) from .exr, .hdr (Radiance's) or .npy.

    Raises:
        SceneError: it cannot be read, or is no map.
    """
    reader = {".npy": _npy, ".exr": _exr, ".hdr": _hdr}.get(path.suffix.lower())
    if reader is None:
        raise SceneError(f"{path}: a map is an .exr, .hdr or .npy file")
    if reader is _hdr and importlib.util.find_spec("OpenImageIO") is None:
        raise SceneError(f"{path}: .hdr files need OpenImageIO: pip install 'merlfit[hdr]', or convert it to .exr")
    with opened(path, SceneError) as (file, _):
        try:
            found = reader(file)
        except (OSError, MemoryError):  # said by `opened`
            raise
        except Exception as error:  # of any kind: NumPy and OpenEXR raise many
            said = (str(error).splitlines() or [type(error).__name__])[0][:200]
            raise SceneError(f"{path}: cannot be read as a map ({said})") from None
    if found.ndim != 3 or found.shape[2] != 3 or min(found.shape[:2]) < 2:
        raise SceneError(f"{path}: a map has the shape (height, width, 3), not {found.shape}")
    if not np.all(np.isfinite(found)) or found.max() <= 0 or -np.minimum(found, 0).sum() > NEGATIVE * found.sum():
        raise SceneError(f"{path}: a map's radiance is finite and not negative, and not 0 everywhere")
    found = np.maximum(found, 0.0)
    if found.max() > BRIGHTEST:
        raise SceneError(f"{path}: a map's radiance is at most {BRIGHTEST:g}, not {found.max():g}")
    return found


def _npy(file: IO[bytes]) -> np.ndarray:
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("it is of another version of NumPy's format than 1.0")
    shape, _, kind = np.lib.format.read_array_header_1_0(file)
    if kind.kind not in "fiu":
        raise ValueError("radiance is real, not complex or any other kind")
    _fits(shape)
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False).astype(float)


def _exr(file: IO[bytes]) -> np.ndarray:
    import OpenEXR

    with _quiet(), OpenEXR.File(file.name, header_only=True) as exr:
        for part in exr.parts:
            low, high = part.header["dataWindow"]
            _fits((*(np.asarray(high, float) - low + 1), len(part.header["channels"])))
    with _quiet(), OpenEXR.File(file.name) as exr:
        channels = exr.channels()
        one = channels.get("RGB") or channels.get("RGBA")
        return np.asarray(one.pixels[..., :3] if one else np.stack([channels[k].pixels for k in "RGB"], -1), float)


def _hdr(file: IO[bytes]) -> np.ndarray:
    import OpenImageIO

    image = OpenImageIO.ImageInput.open(file.name)
    if image is None:
        raise ValueError(OpenImageIO.geterror())
    spec = image.spec()
    _fits((spec.height, spec.width, spec.nchannels))
    found = image.read_image(OpenImageIO.FLOAT)
    if found is None:
        raise ValueError(image.geterror())
    return np.asarray(found, float)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what OpenEXR prints by itself, from Python and from C, beside what it raises."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _fits(shape: Sequence[float]) -> None:
    """Refuse what says to be larger than a map may be, before memory is taken for it."""
    if math.prod(shape) > LARGEST:
        raise ValueError(f"it says to hold {math.prod(shape):.3g} numbers, more than the {LARGEST:.3g} of a map")
