"""Spheres as pictures: which pixels are computed, of which bins each is the sum, and how they are sent."""

import base64
import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from ...merl_io.binary import Dims
from ...scene.colour import displayed
from ...scene.spheres import Lighting, sphere
from ..show.spheres import COMPUTED, SIDE, square

QUICK: dict[Lighting, int] = {"lamp": SIDE, "environment": 80}  # pixels that are computed while something moves


@dataclass(frozen=True)
class Disc:
    """A sphere in a square of pixels.

    Attributes:
        weights: pixels inside it as sums over folded bins, (N, bins). filled: for every pixel of the square, (side^2,),
            the one inside it that is nearest.
    """

    weights: csr_array
    filled: np.ndarray

    def encoded(self, radiance: np.ndarray, exposure: float, fine: bool) -> str:
        """The picture as a ``data:`` address: PNG, or JPEG that is quicker; beyond the rim it goes on.

        Args:
            radiance: of the pixels inside, (N, 3). exposure: in stops.
        """
        side = int(np.sqrt(len(self.filled)))
        image = Image.fromarray(displayed(radiance * np.float32(2.0**exposure))[self.filled].reshape(side, side, 3))
        image = image if side == SIDE else image.resize((SIDE, SIDE), Image.Resampling.BICUBIC)
        kind, settings = ("png", {"compress_level": 1}) if fine else ("jpeg", {"quality": 92, "subsampling": 0})
        file = io.BytesIO()
        image.save(file, kind, **settings)
        return f"data:image/{kind};base64,{base64.b64encode(file.getvalue()).decode()}"


@cache
def disc(lighting: Lighting, side: int, dims: Dims) -> Disc:
    """Made once for all materials."""
    positions, inside = square(side)
    number = np.cumsum(inside.ravel()).reshape(inside.shape) - 1
    row, column = np.asarray(distance_transform_edt(~inside, return_distances=False, return_indices=True))
    found = sphere(lighting, positions[inside], dims)
    small = csr_array(
        (found.data.astype(np.float32), found.indices.astype(np.int32), found.indptr.astype(np.int32)), found.shape
    )
    return Disc(small, number[row, column].ravel())


def pictures(radiance: Mapping[Lighting, np.ndarray], dims: Dims, exposure: float, moving: bool) -> dict[str, str]:
    """Addresses of pictures by lighting."""
    sides = QUICK if moving else COMPUTED
    return {
        lighting: disc(lighting, sides[lighting], dims).encoded(found, exposure, not moving)
        for lighting, found in radiance.items()
    }
