"""Image files: EXR of radiance, PNG for screens, and environment maps; through OpenEXR and Pillow."""

from pathlib import Path
from typing import IO
from zipfile import BadZipFile

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from ..merl_io.atomic import write_atomically
from .colour import displayed
from .description import SceneError

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
    """An environment's radiance (H, W, 3) from .exr or .npy.

    Raises:
        SceneError: it cannot be read, or is no map.
    """
    try:
        if path.suffix.lower() == ".npy":
            with path.open("rb") as file:  # np.load leaves a file open that is no archive
                found = np.load(file, allow_pickle=False)
        elif path.suffix.lower() == ".exr":
            import OpenEXR

            path.stat()  # its own error says nothing of the file
            with OpenEXR.File(str(path)) as file:
                channels = file.channels()
                one = channels.get("RGB") or channels.get("RGBA")
                found = one.pixels[..., :3] if one else np.stack([channels[k].pixels for k in "RGB"], -1)
        else:
            raise SceneError(f"{path}: a map is an .exr or .npy file")
        if np.iscomplexobj(found):
            raise SceneError(f"{path}: a map's radiance is real, not complex")
        found = np.asarray(found, float)
    except SceneError:
        raise
    except (OSError, EOFError, ValueError, TypeError, KeyError, RuntimeError, BadZipFile) as error:
        raise SceneError(f"{path}: cannot be read as a map ({error})") from None
    if found.ndim != 3 or found.shape[2] != 3 or min(found.shape[:2]) < 2:
        raise SceneError(f"{path}: a map has the shape (height, width, 3), not {found.shape}")
    if not np.all(np.isfinite(found)) or found.min() < 0 or found.max() == 0:
        raise SceneError(f"{path}: a map's radiance is finite and not negative, and not 0 everywhere")
    if found.max() > BRIGHTEST:
        raise SceneError(f"{path}: a map's radiance is at most {BRIGHTEST:g}, not {found.max():g}")
    return found
