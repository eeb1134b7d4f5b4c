"""The largest share of the light that a material gives back: above one it makes light, which a renderer shows."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike

from ...merl_io.bands import Bands
from ...model.reflectance import Reflectance
from ...model.two_scale import TwoScale
from .total_scatter import of_values

INCIDENCES_DEG = (0.0, 20.0, 40.0, 60.0, 70.0, 80.0)  # up to where data are fitted (`choices.THETA_MAX`)
TOO_MUCH = 1.01  # the rule's own error is below half of what this leaves


class Brightest(NamedTuple):
    """Where a material gives back most of the light: the share, the light's angle, the channel."""

    albedo: float
    degrees: float
    channel: str

    @property
    def excessive(self) -> bool:
        """Whether it is more than there was."""
        return self.albedo > TOO_MUCH


def largest_albedo(material: Reflectance, values: Mapping[str, ArrayLike], bands: Bands) -> Brightest | None:
    """The largest albedo without the apparatus, of light from 0 to 80 degrees; None where it cannot exceed one.

    By :func:`.total_scatter.of_values`, whose program it shares.
    """
    if isinstance(material, TwoScale) and material.split == "conserving":
        return None
    own = {q.name: np.asarray(values[q.name])[None] for q in material.parameters}
    (found,) = of_values(material, own, bands, np.radians(INCIDENCES_DEG))
    channel, k = np.unravel_index(np.argmax(found), found.shape)
    return Brightest(float(found[channel, k]), INCIDENCES_DEG[k], bands.names[channel])
