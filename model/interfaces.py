"""Constants of interfaces that are worth a try where a fit starts (:class:`merlfit.model.reflectance.Separated`)."""

from itertools import product

import jax.numpy as jnp
import numpy as np
from jax import Array

from .fresnel import fresnel, schlick

_METALS = np.array(list(product(np.geomspace(0.05, 6, 14), np.geomspace(0.05, 12, 14)))).T
METALS = {"n": _METALS[0], "k": _METALS[1]}
DIELECTRICS = {"eta": 1 + np.geomspace(0.15, 1.55, 10)}
FACETS = {"F0": np.geomspace(0.003, 0.95, 16)}


def fresnel_of_dielectric(cos_d: Array, eta: Array) -> Array:
    """Reflectance without an imaginary part of the index."""
    return fresnel(cos_d, eta, jnp.zeros_like(eta))


def schlick_of_dielectric(cos_d: Array, eta: Array) -> Array:
    """The same by Schlick's polynomial."""
    return schlick(cos_d, eta, jnp.zeros_like(eta))
