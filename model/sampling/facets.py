"""Mirror directions of facets that are drawn by their projected area (HP17 Eq. 49-50, HP15 Eq. 22-23, IL Eq. 29-31)."""

from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.special import gammainc, gammaincc
from jax.typing import ArrayLike

from .. import piecewise
from ..geometry import Geometry
from ..ndf import beckmann, ggx
from ..ndf.epd import epd
from ..numerics import Scalar

QUANTILES = 513  # nodes of the quantile's logarithm
LEAST, MOST = -30.0, 3.6  # of log(-log(1 - u)): from u = 1e-13 to the last number below 1
SMALLEST_LOG = -300.0  # of what the quantile may be
NOTHING = (0.0, 0.0, -1.0)  # straight down


@runtime_checkable
class Normals(Protocol):
    """A distribution of facets that can be drawn from."""

    def tangent(self, u: Array) -> Array:
        """tan(theta_m) below which the share ``u`` of the projected area is."""
        ...

    def D(self, theta: Array) -> Array:
        """Distribution of normals (1/sr)."""
        ...


class EPD(eqx.Module):
    """The exponential power distribution, tan(theta_m) = beta x^(1/2p) with x of a Gamma(1/p) law (HP17 Eq. 49).

    HP15 Eq. 23 prints the exponent p/2. The quantile of that law is looked up, to 1e-7
    (``tests/sampling/test_sampling.py``).
    """

    beta: Array
    p: Array
    log_quantile: Array

    def __init__(self, beta: ArrayLike, p: ArrayLike) -> None:
        self.beta, self.p = jnp.asarray(beta, float), jnp.asarray(p, float)
        self.log_quantile = log_gamma_quantile(1 / self.p)

    def tangent(self, u: Array) -> Array:
        """From the table, even in log(-log(1 - u)), where its logarithm is nearly straight at both ends."""
        z = jnp.log(-jnp.log1p(-jnp.clip(u, 1e-13, 1 - 2**-52)))
        position = (z - LEAST) / (MOST - LEAST) * (QUANTILES - 1)
        return self.beta * jnp.exp(piecewise.interpolate(self.log_quantile, position) / (2 * self.p))

    def D(self, theta: Array) -> Array:
        """HP17 Eq. 34-35."""
        return epd(theta, self.beta, self.p)


class Beckmann(eqx.Module):
    """Beckmann's distribution of width ``alpha`` (IL Eq. 29-30, isotropic)."""

    alpha: Array

    def tangent(self, u: Array) -> Array:
        """In closed form."""
        return self.alpha * jnp.sqrt(-jnp.log1p(-u))

    def D(self, theta: Array) -> Array:
        """IL Eq. 15."""
        return beckmann.D(theta, self.alpha)


class GGX(eqx.Module):
    """The GGX distribution of width ``alpha`` (IL Eq. 29, 31, isotropic)."""

    alpha: Array

    def tangent(self, u: Array) -> Array:
        """In closed form."""
        return self.alpha * jnp.sqrt(u / (1 - u))

    def D(self, theta: Array) -> Array:
        """IL Eq. 20."""
        return ggx.D(theta, self.alpha)


def log_gamma_quantile(shape: Scalar) -> Array:
    """Logarithm of the quantile of a Gamma law at even log(-log(1 - u)), (QUANTILES,), by bisection."""
    u = -jnp.expm1(-jnp.exp(jnp.linspace(LEAST, MOST, QUANTILES)))
    above = jnp.exp(-jnp.exp(jnp.linspace(LEAST, MOST, QUANTILES)))

    def halve(_: Array | int, between: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = between
        middle = (low + high) / 2
        x = jnp.exp(middle)
        beyond = jnp.where(u < 0.5, gammainc(shape, x) > u, gammaincc(shape, x) < above)
        return jnp.where(beyond, low, middle), jnp.where(beyond, middle, high)

    ends = jnp.full(QUANTILES, SMALLEST_LOG), jnp.full(QUANTILES, 5.0)
    return jax.lax.fori_loop(0, 56, halve, ends)[0]


def mirrored(given: Array, facet: Array) -> Array:
    """Where a facet of normal ``facet`` sends light; :data:`NOTHING` from its back."""
    dot = jnp.sum(given * facet, -1, keepdims=True)
    return jnp.where(dot > 0, 2 * dot * facet - given, jnp.asarray(NOTHING, facet.dtype))


class Facets(eqx.Module):
    """Facets by their projected area, whether they are seen or not: the sampling of HP17 4.6, HP15 5.2 and IL 4.1.

    Its weight for F D G / (4 cos_i cos_o) is F G cos_d / (cos_given cos_m), which grows without bound towards grazing
    directions (HP17 Fig. 9b). :class:`merlfit.model.sampling.visible.Visible` has none of this.
    """

    normals: Normals
    dimensions = 2

    def draw(self, given: Array, u: Array) -> Array:
        """Below the horizon where the facet's mirror direction is."""
        tangent, turn = self.normals.tangent(u[..., 0]), 2 * jnp.pi * u[..., 1]
        cos = 1 / jnp.sqrt(1 + tangent**2)
        facet = jnp.stack([tangent * cos * jnp.cos(turn), tangent * cos * jnp.sin(turn), cos], -1)
        return mirrored(given, facet)

    def density(self, given: Array, drawn: Array) -> Array:
        """D cos(theta_h) / (4 cos_d), HP17 below Eq. 50."""
        above = drawn[..., 2] > 0
        g = Geometry.from_vectors(given, jnp.where(above[..., None], drawn, given))
        found = self.normals.D(g.theta_h) * jnp.cos(g.theta_h) / (4 * jnp.cos(g.theta_d))
        return jnp.where(above, found, 0.0)
