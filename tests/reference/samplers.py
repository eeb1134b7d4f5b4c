"""The papers' own samplers: facets by projected area, the diffraction lobe by its shape, mixtures of both and a body.

HP17 4.6, Eq. 48-55; HP15 Section 5, Eq. 22-23; IL 4.1, Eq. 29-31. merlfit draws by `model.sampling.visible` instead;
these are what it is compared with, and where the printed formulas were found wrong.
"""

from collections.abc import Mapping
from functools import reduce
from operator import add

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import gammainc, gammaincc
from jax.typing import ArrayLike
from merlfit.model import piecewise
from merlfit.model.body import external_diffuse_reflectance, internal_diffuse_reflectance, substrate
from merlfit.model.diffraction import lobe_amplitude, phase_variance
from merlfit.model.geometry import Geometry
from merlfit.model.ndf import beckmann, ggx
from merlfit.model.ndf.epd import epd
from merlfit.model.numerics import Scalar, safe_acos, safe_divide, safe_sqrt
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.sampling import Sampler
from merlfit.model.sampling.hemisphere import Cosine
from merlfit.model.sampling.visible import mirrored

QUANTILES = 513  # nodes of the quantile's logarithm
LEAST, MOST = -30.0, 3.6  # of log(-log(1 - u)): from u = 1e-13 to the last number below 1
SMALLEST_LOG = -300.0  # of what the quantile may be
NARROWEST = 1e-12  # radius below which its direction does not matter
COSINES = 65  # of directions at which shares are tabulated
MIDDLE_UM = WAVELENGTHS_UM[1]


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


class Facets(eqx.Module):
    """Facets by their projected area, whether they are seen or not: the sampling of HP17 4.6, HP15 5.2 and IL 4.1.

    Its weight for F D G / (4 cos_i cos_o) is F G cos_d / (cos_given cos_m), which grows without bound towards grazing
    directions (HP17 Fig. 9b). :class:`merlfit.model.sampling.visible.Visible` has none of this.
    """

    normals: EPD | Beckmann | GGX
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


class Diffracted(eqx.Module):
    """On the disc of projected directions, around the mirror direction of a flat surface, at one wavelength.

    With r = lambda f the distance from -i_p, and s = sin(theta_i), the density is

        S_HS(r) / M  pi / phi_max  cos_o,    cos(phi_max) = max(-1, (r^2 + s^2 - 1) / (2 r s)),

    M the lobe's integral up to 1 + s (Eq. 52). Two errata, both found by the chi-square test: the printed density lacks
    1/M, and Eq. 54 turns by pi too much (o_p = -i_p + lambda f is within the disc where f points towards its centre).
    """

    b_over_lambda: Array
    c: Array
    dimensions = 2

    def __init__(self, b_over_lambda: ArrayLike, c: ArrayLike) -> None:
        self.b_over_lambda, self.c = jnp.asarray(b_over_lambda, float), jnp.asarray(c, float)

    def draw(self, given: Array, u: Array) -> Array:
        """Never below the horizon."""
        s, bl = _sine(given), self.b_over_lambda
        falloff = -2 / (self.c - 1) * jnp.log1p(-self._mass(s) * u[..., 0])
        r = safe_sqrt(jnp.expm1(falloff)) / bl
        azimuth = jnp.arctan2(given[..., 1], given[..., 0]) + (2 * u[..., 1] - 1) * _widest(r, s)
        x, y = r * jnp.cos(azimuth) - given[..., 0], r * jnp.sin(azimuth) - given[..., 1]
        return jnp.stack([x, y, safe_sqrt(1 - x * x - y * y)], -1)

    def density(self, given: Array, drawn: Array) -> Array:
        """S_HS(f) / M pi / phi_max cos_o."""
        s, bl = _sine(given), self.b_over_lambda
        r = jnp.hypot(given[..., 0] + drawn[..., 0], given[..., 1] + drawn[..., 1])
        shape = jnp.exp(-(self.c + 1) / 2 * jnp.log1p((bl * r) ** 2))
        turned = safe_divide(jnp.pi, _widest(r, s))
        return lobe_amplitude(bl, self.c) * shape / self._mass(s) * turned * jnp.maximum(drawn[..., 2], 0.0)

    def _mass(self, s: Array) -> Array:
        """Share of the lobe within 1 + s (Eq. 52)."""
        return -jnp.expm1(-(self.c - 1) / 2 * jnp.log1p((self.b_over_lambda * (1 + s)) ** 2))


def _sine(given: Array) -> Array:
    return jnp.hypot(given[..., 0], given[..., 1])


def _widest(r: Array, s: Array) -> Array:
    """phi_max of Eq. 53."""
    whole = 2 * r * s < NARROWEST
    cos = (r * r + s * s - 1) / jnp.where(whole, 1.0, 2 * r * s)
    return jnp.where(whole, jnp.pi, safe_acos(jnp.clip(cos, -1.0, 1.0)))


class Mixture(eqx.Module):
    """Ways and their shares, which may depend on the cosine of the given direction with the normal.

    Attributes:
        parts: the ways, (K). shares: of them, (K,), or (K, N) at even steps of the cosine from 0 to 1, linear between;
            each column sums to one.
    """

    parts: tuple[Sampler, ...]
    shares: Array

    @property
    def dimensions(self) -> int:
        """One to choose by, and those of the parts."""
        return 1 + max(part.dimensions for part in self.parts)

    def draw(self, given: Array, u: Array) -> Array:
        """Direction of the part that the first number chooses."""
        below, drawn = jnp.zeros_like(u[..., 0]), jnp.broadcast_to(given, (*u.shape[:-1], 3))
        for part, share in zip(self.parts, self._shares(given), strict=True):
            chosen = (u[..., 0] >= below) & (u[..., 0] < below + share)
            drawn = jnp.where(chosen[..., None], part.draw(given, u[..., 1 : 1 + part.dimensions]), drawn)
            below = below + share
        return drawn

    def density(self, given: Array, drawn: Array) -> Array:
        """Sum of shares times densities."""
        each = [share * part.density(given, drawn) for part, share in zip(self.parts, self._shares(given), strict=True)]
        return reduce(add, each)

    def _shares(self, given: Array) -> Array:
        """(K, ...) at the given directions; rounding leaves the last part what is missing to one."""
        if self.shares.ndim == 1:
            found = self.shares.reshape(-1, *(1,) * (given.ndim - 1))
        else:
            position = jnp.clip(given[..., 2], 0.0, 1.0) * (self.shares.shape[1] - 1)
            cell = jnp.clip(position.astype(jnp.int32), 0, self.shares.shape[1] - 2)
            t = position - cell
            found = self.shares[:, cell] * (1 - t) + self.shares[:, cell + 1] * t
        return jnp.concatenate([found[:-1], 1 - jnp.sum(found[:-1], 0, keepdims=True)])


def _mean(value: ArrayLike) -> Array:
    """Mean over the channels."""
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
    weights = jnp.stack([r_e, np.pi * substrate(n, albedo, internal_diffuse_reflectance(n)) * (1 - r_e) ** 2])
    return Mixture((Facets(Beckmann(_mean(v["roughness"]))), Cosine()), weights / jnp.sum(weights))
