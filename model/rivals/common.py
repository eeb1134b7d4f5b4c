"""Parameters and citations that several rival models share."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..body import lambert_of
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import Reflectance, Separated

LOEW_PAPER = (
    "Loew, Kronander, Ynnerman & Unger 2012, BRDF models for accurate and efficient rendering of glossy surfaces, "
    "doi:10.1145/2077341.2077350"
)
DIFFUSE = Parameter("diffuse_albedo", r"\rho_d", "albedo of the diffuse term", "1", 0.1, 0.0, 1.0, "linear",
                    per_channel=True, source="Cook & Torrance 1982", quantity="odds")  # fmt: skip
LOEW_ETA = Parameter("eta", r"\eta", "index of refraction", "1", 1.5, 1.001, 200.0, offset=1.0,
                     source="Loew et al. 2012", prior=LogNormal(0.8, 3.0))  # fmt: skip


def weighted(model: Reflectance, weight: str, least: float, most: float) -> Separated:
    """Of a model whose channels are a weight times a lobe that all share, and a Lambert body.

    Args:
        weight: name of the parameter. least, most: between which values are tried where a fit starts.
    """
    fixed = ((weight, 1.0), (DIFFUSE.name, 0.0))
    tried = {weight: np.geomspace(least, most, 28)}
    return Separated(model, fixed, tried, _alone, False, lambert_of, albedo=DIFFUSE.name)


def _alone(cos_d: Array, **weight: Array) -> Array:
    """The weight, whatever the angle."""
    return next(iter(weight.values())) * jnp.ones_like(cos_d)
