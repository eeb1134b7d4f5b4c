"""Pictures of a material's page, as WebP files."""

from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from ...merl_io.atomic import write_atomically
from ..pipeline.draws import NoPicture
from .curves import part_name
from .pictures import PICTURES
from .spheres import of_file_and_fit, of_parts
from .style import own_style
from .subject import Subject

FIGURES = ("scans", "isolines", "errors", "residuals", "corner", "corner-all", "trace")
DPI = 200  # of a figure that is 8.5 cm wide: 670 pixels
THUMBNAIL = 128


def write(subject: Subject, out: Path, name: str) -> dict[str, Any]:
    """Write the pictures of a page.

    Returns:
        ``pictures``: their files by what they show, seen from the page. ``parts``: of each effect its name, its
        picture, and its share of the sphere's light by channel.
    """
    found: dict[str, str] = {}

    def keep(what: str, picture: Image.Image, lossless: bool = False) -> str:
        path = out / "pictures" / f"{name}.{what}.webp"
        write_atomically(
            path, lambda file: picture.save(file, "WEBP", quality=50 if lossless else 90, lossless=lossless, method=2)
        )
        return f"../pictures/{quote(path.name)}"

    for lighting, pictures in of_file_and_fit(subject).items():
        for kind, picture in pictures.items():
            found[f"{lighting}-{kind}"] = keep(f"{lighting}-{kind}", _image(picture))
            if lighting == "environment" and kind in ("file", "fit"):
                small = _image(picture).resize((THUMBNAIL, THUMBNAIL), Image.Resampling.LANCZOS)
                keep(f"small-{kind}", small)
    shown, shares = of_parts(subject)
    parts = [
        {"words": part_name(part), "picture": keep(f"part-{part}", _image(shown[part])), "shares": shares[part]}
        for part in shown
    ]
    for what in FIGURES:
        try:
            found[what] = keep(what, _drawn(subject, what), lossless=True)
        except NoPicture:  # the page says why
            continue
    return {"pictures": found, "parts": parts}


def _image(picture: np.ndarray) -> Image.Image:
    return Image.fromarray(picture, "RGBA")


def _drawn(subject: Subject, what: str) -> Image.Image:
    figure = PICTURES[what].draw(subject)
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    with own_style():
        canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
