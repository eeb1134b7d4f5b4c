"""Image files: EXR of radiance, PNG for screens, and environment maps; through OpenEXR and Pillow."""

import os
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from .colour import displayed
from .description import SceneError


def write_exr(path: Path, radiance: np.ndarray) -> None:
    """Linear RGB (H, W, 3) as floats of 32 bits, atomically."""
    import OpenEXR  # a quarter of a second that only pictures are worth

    image = np.ascontiguousarray(radiance, np.float32)
    handle, name = tempfile.mkstemp(suffix=".exr", dir=path.parent)
    os.close(handle)
    try:
        with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, {"RGB": image}) as file:
            file.write(name)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def write_png(path: Path, radiance: np.ndarray) -> None:
    """Linear RGB (H, W, 3) over white as a screen shows it, or (H, W, 3) of 8 bits as it is."""
    image = radiance if radiance.dtype == np.uint8 else displayed(radiance)
    with tempfile.NamedTemporaryFile(suffix=".png", dir=path.parent, delete=False) as file:
        Image.fromarray(image).save(file, "PNG", optimize=True)
    os.chmod(file.name, 0o644)
    os.replace(file.name, path)


def read_map(path: Path) -> np.ndarray:
    """An environment's radiance (H, W, 3) from .exr or .npy.

    Raises:
        SceneError: it cannot be read, or is no map.
    """
    try:
        if path.suffix == ".npy":
            found = np.load(path, allow_pickle=False)
        elif path.suffix == ".exr":
            import OpenEXR

            path.stat()  # its own error says nothing of the file
            with OpenEXR.File(str(path)) as file:
                channels = file.channels()
                one = channels.get("RGB") or channels.get("RGBA")
                found = one.pixels[..., :3] if one else np.stack([channels[k].pixels for k in "RGB"], -1)
        else:
            raise SceneError(f"{path}: a map is an .exr or .npy file")
        found = np.asarray(found, float)
    except SceneError:
        raise
    except (OSError, EOFError, ValueError, TypeError, KeyError, RuntimeError) as error:
        raise SceneError(f"{path}: cannot be read as a map ({error})") from None
    if found.ndim != 3 or found.shape[2] != 3 or min(found.shape[:2]) < 2:
        raise SceneError(f"{path}: a map has the shape (height, width, 3), not {found.shape}")
    if not np.all(np.isfinite(found)) or found.min() < 0 or found.max() == 0:
        raise SceneError(f"{path}: a map's radiance is finite and not negative, and not 0 everywhere")
    return found
