"""The papers' own samplers: which lobe to draw from, and how."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from ..body import external_diffuse_reflectance, substrate
from ..diffraction import phase_variance
from ..parameters import WAVELENGTHS_UM
from .diffracted import Diffracted
from .facets import EPD, Beckmann, Facets
from .hemisphere import Cosine
from .mixture import Mixture

COSINES = 65  # of directions at which shares are tabulated
MIDDLE_UM = WAVELENGTHS_UM[1]


def _mean(value: ArrayLike) -> Array:
    """Of the channels."""
    return jnp.mean(jnp.asarray(value, float))


def hp17(v: Mapping[str, ArrayLike], wavelength_um: float = MIDDLE_UM) -> Mixture:
    """HP17 4.6: facets in the share A_imp of what is reflected, else the diffraction lobe; a body by the cosine.

    A_imp is A_spec of a facet in the surface's plane without renormalisation; Eq. 48 prints 2 pi for the 4 pi of Eq.
    25, and any share between 0 and 1 will do. The lobe is that of a surface without facets, at one wavelength.
    """
    cosines = jnp.linspace(0.0, 1.0, COSINES)
    variance = phase_variance(jnp.asarray(v["sigma_s"], float) ** 2, cosines, jnp.asarray(wavelength_um))
    body = _mean(v.get("albedo", 0.0)) / 2
    facets = jnp.exp(-variance) * (1 - body)
    parts = (
        Facets(EPD(v["beta"], v["p"])),
        Diffracted(jnp.asarray(v["b"], float) / wavelength_um, v["c"]),
        Cosine(),
    )
    return Mixture(parts, jnp.stack([facets, 1 - body - facets, jnp.broadcast_to(body, facets.shape)]))


def hp15(v: Mapping[str, ArrayLike]) -> Mixture:
    """HP15 5.5: facets in the share k_s; diffracted light (k_w/lambda^4, middle channel) and body by the cosine."""
    weights = jnp.stack([_mean(v["k_s"]), _mean(v["k_w"]) / MIDDLE_UM**4 + _mean(v["diffuse_albedo"])])
    return Mixture((Facets(EPD(v["beta"], v["p"])), Cosine()), weights / jnp.sum(weights))


def interfaced_lambertian(v: Mapping[str, ArrayLike]) -> Mixture:
    """IL 4.1 with Beckmann's normals: facets or body in the ratio of r_e to what a flat surface's body gives back."""
    n, albedo = _mean(v["eta"]), _mean(v["albedo"])
    r_e = external_diffuse_reflectance(n)
    weights = jnp.stack([r_e, np.pi * substrate(n, albedo) * (1 - r_e) ** 2])
    return Mixture((Facets(Beckmann(_mean(v["roughness"]))), Cosine()), weights / jnp.sum(weights))
