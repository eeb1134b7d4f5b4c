"""The largest share of the light that a material gives back: above one it makes light, which a renderer shows."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from ...merl_io.bands import Bands
from ...model.albedo import directional_albedo
from ...model.reflectance import Reflectance
from ...model.two_scale import TwoScale
from ..support.kept import kept
from .hints import general_of

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

    One program for all variants of a model (:func:`.hints.general_of`), 0.1 s.
    """
    if isinstance(material, TwoScale) and material.split == "conserving":
        return None
    general = general_of(material)
    given = general.values({q.name: jnp.asarray(values[q.name]) for q in material.parameters})
    found = np.asarray(_albedos(general.model, given, jnp.asarray(bands.wavelengths_um)))
    channel, k = np.unravel_index(np.argmax(found), found.shape)
    return Brightest(float(found[channel, k]), INCIDENCES_DEG[k], bands.names[channel])


@kept()
def _albedos(model: Reflectance, values: Mapping[str, Array], wavelengths_um: Array) -> Array:
    return directional_albedo(model, values, jnp.radians(jnp.asarray(INCIDENCES_DEG)), wavelengths_um)
