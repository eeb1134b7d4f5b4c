"""The smooth-surface (ABC) model of Loew, Kronander, Ynnerman & Unger 2012 (doi:10.1145/2077341.2077350)."""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ..fresnel import fresnel
from ..geometry import Geometry
from ..numerics import safe_sqrt
from ..parameters import Parameter
from .common import projected_half_squared, visible, with_channels

SOURCE = "Loew et al. 2012"


class Smooth(eqx.Module):
    """Parameters; see ``PARAMETERS``. Also those of :mod:`.abc_microfacet`, with other values of A, B and C."""

    diffuse_albedo: Array  # (3,)
    A: Array  # (3,), 1/sr
    B: Array
    C: Array
    eta: Array


PARAMETERS = (
    Parameter("diffuse_albedo", r"\rho_d", "albedo of the diffuse term", "1", 0.1, 0.0, 1.0, "linear",
              per_channel=True, source=SOURCE),
    Parameter("A", "A", "height of the lobe", "1/sr", 50.0, 1e-3, 1e5, per_channel=True, source=SOURCE),
    Parameter("B", "B", "inverse square of the lobe's width", "1", 3e3, 1e-1, 1e8, source=SOURCE),
    Parameter("C", "C", "falloff exponent of the lobe's tail", "1", 1.0, 1e-2, 10.0, source=SOURCE),
    Parameter("eta", r"\eta", "index of refraction", "1", 1.5, 1.001, 100.0, offset=1.0, source=SOURCE),
)  # fmt: skip


def lobe(squared: Array, B: Array, C: Array) -> Array:
    """The ABC function ``(1 + B x)^-C`` of a non-negative ``x``."""
    return jnp.exp(-C * jnp.log1p(B * squared))


def facet_cosine(geometry: Geometry) -> Array:
    """``sqrt(1 - |i_p - o_p|^2 / 4)`` of the projected directions (Loew et al. Eq. 14).

    Formed as ``sqrt(cos_d^2 + (cos_i - cos_o)^2 / 4)``, the same thing without cancellation.
    """
    return safe_sqrt(geometry.cos_d**2 + (geometry.cos_i - geometry.cos_o) ** 2 / 4)


def evaluate(parameters: Smooth, geometry: Geometry) -> Array:
    """BRDF (1/sr), ``k_d / pi + A F (1 + B D_p^2)^-C``, ``D_p`` the length of i + o projected (Loew et al. Eq. 10-14).

    F is the Fresnel reflectance of a dielectric of index eta at :func:`facet_cosine`; there is no masking.

    Args:
        parameters: A and diffuse_albedo one value a channel, the others shared.
        geometry: directions, scattered or as a broadcast grid.

    Returns:
        shape ``(*broadcast shape of geometry, 3)``; 0 where light or viewer are not above the surface.

    Reciprocal. Values and gradients are finite everywhere. Accuracy: 1e-9 against an independent oracle
    (``tests/rivals/test_rivals.py``); with the published parameters the median errors over MERL are RMSE 0.045,
    sMAPE 0.100 (``tests/rivals/test_published.py``).
    """
    q, (g, above) = parameters, with_channels(geometry)
    F = fresnel(facet_cosine(g), q.eta, jnp.zeros(()))
    return visible(q.diffuse_albedo, q.A * F * lobe(projected_half_squared(g), q.B, q.C), above)
