"""The diffraction lobe without the convolution: HP17 Eq. 27 by adaptive quadrature over microfacet normals.

    rho_CTD = G / (cos_i cos_o) Int Q/2 (1 - A) S_HS D (i.m)+ (o.m)+ domega_m,
    A = exp(-(2 pi sigma_rel (i.m + o.m)/lambda)^2)                                                       (Eq. 23)

Q and A see the angles to m, as Eq. 22 lives on the facet; sigma_rel is that of theta_d, which keeps it reciprocal.

Rings of normals about n: the azimuth is cut where a facet turns away from i or o, where the integrand has kinks, and
stretched around h by phi = w sinh(s), which makes a lobe of any sharpness smooth. The radius, in y = log tan(theta_m),
is bisected where a Gauss-Kronrod pair disagrees most. The mesh is found without derivatives; the integral on it is an
ordinary sum, with both modes of differentiation.

This is the reference that the cheaper tiers are measured against (``docs/physics.md``): milliseconds a direction.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .fresnel import diffraction_colour
from .ndf.epd import log_p22_peak
from .numerics import Real, Scalar, safe_acos, safe_divide, safe_sqrt
from .quadrature import gauss_legendre

PANELS = 28  # radial panels of a finished mesh
FIRST = 12  # of them before bisection
TOLERANCE = 1e-5  # of the integral: difference of the pair at which bisection stops; the value is far better
BETWEEN_CUTS = 20  # Gauss nodes between two cuts of a ring
TAIL = 11.0  # log-radii below the narrower of D and S: what is left out is e^-22 of the lobe
BATCH = 32  # directions integrated at a time

# Gauss-Kronrod pair of 7 and 15 nodes on [-1, 1] (QUADPACK's qk15)
_KRONROD_NODES = np.array([
    0.991455371120812639206854697526329, 0.949107912342758524526189684047851, 0.864864423359769072789712788640926,
    0.741531185599394439863864773280788, 0.586087235467691130294144691693013, 0.405845151377397166906606412076961,
    0.207784955007898467600689403773245, 0.0,
])  # fmt: skip
_KRONROD_WEIGHTS = np.array([
    0.022935322010529224963732008058970, 0.063092092629978553290700663189204, 0.104790010322250183839876322541518,
    0.140653259715525918745189590510238, 0.169004726639267902826583426598550, 0.190350578064785409913256402421014,
    0.204432940075298892414161999234649, 0.209482141084727828012999174891714,
])  # fmt: skip
_GAUSS_WEIGHTS = np.array([
    0.129484966168869693270611432679082, 0.279705391489276667901467771423780, 0.381830050505118944950369775488975,
    0.417959183673469387755102040816327,
])  # fmt: skip
KRONROD = np.concatenate([-_KRONROD_NODES, _KRONROD_NODES[-2::-1]])
WEIGHTS_15 = np.concatenate([_KRONROD_WEIGHTS, _KRONROD_WEIGHTS[-2::-1]])
WEIGHTS_7 = np.zeros(15)
WEIGHTS_7[1::2] = np.concatenate([_GAUSS_WEIGHTS, _GAUSS_WEIGHTS[-2::-1]])


class Pair(NamedTuple):
    """One pair of directions in the frame of n whose x axis points along h, and what its facets' lobe is made of.

    All scalars; c, beta and p are the same for all pairs. ``sin_d_cos`` and ``sin_d_sin`` are sin(theta_d) times cosine
    and sine of phi_d; ``phase`` is (4 pi sigma_rel cos_d/lambda)^2.
    """

    sin_h: Array
    cos_h: Array
    cos_d: Array
    sin_d_cos: Array
    sin_d_sin: Array
    B: Array
    phase: Array
    n: Array
    k: Array
    c: Array
    beta: Array
    p: Array


def lobe(
    theta_h: Real, theta_d: Real, cos_i: Real, cos_o: Real, B: Real, phase: Real, n: Real, k: Real,
    c: Scalar, beta: Scalar, p: Scalar, *, coloured: bool,
) -> Real:  # fmt: skip
    """Int (Q/2) (1 - A) S D (i.m)(o.m) domega_m / (cos_i cos_o), without the amplitude of S and without G.

    Args:
        theta_h, theta_d, cos_i, cos_o: directions above the horizon; all arrays broadcast.
        B: 2 (b/lambda) cos_d. phase: (4 pi sigma_rel cos_d / lambda)^2. n, k: index of refraction.
        c: falloff of the K-correlation spectrum. beta, p: the EPD.
        coloured: whether Q/2 is inside (else 1).

    Accuracy: 1e-5 relative (``tests/model/test_exact.py``), but where facets reflect totally (n below 1 with k = 0):
    Q has a square-root kink there, which the azimuth's rule does not see, and the value is up to 5e-3 off. The mesh
    adapts in the radius; between two cuts of a ring the azimuth has a fixed rule in its stretched variable.
    """
    arrays = jnp.broadcast_arrays(theta_h, theta_d, cos_i, cos_o, B, phase, n, k)
    shape = arrays[0].shape

    def at(point: tuple[Array, ...]) -> Array:
        theta_h, theta_d, cos_i, cos_o, B, phase, n, k = point
        sin_h, sin_d = jnp.sin(theta_h), jnp.sin(theta_d)
        # cos_o - cos_i = 2 sin_h sin_d cos(phi_d); where either vanishes the azimuth means nothing
        cos_phi = jnp.clip(safe_divide((cos_o - cos_i) / 2, sin_h * sin_d), -1.0, 1.0)
        sin_phi = safe_sqrt((1 - cos_phi) * (1 + cos_phi))
        pair = Pair(
            sin_h, jnp.cos(theta_h), jnp.cos(theta_d), sin_d * cos_phi, sin_d * sin_phi, B, phase, n, k, c, beta, p
        )  # fmt: skip
        return _integral(pair, coloured) / (cos_i * cos_o)

    return jax.lax.map(at, tuple(jnp.ravel(x) for x in arrays), batch_size=BATCH).reshape(shape)


def _integral(pair: Pair, coloured: bool) -> Array:
    """Mesh without derivatives, then the sum on it."""
    fixed = jax.tree.map(jax.lax.stop_gradient, pair)
    left, right = _mesh(lambda y: _rings(y, fixed, coloured), *_range(fixed))
    value, _ = _panels(lambda y: _rings(y, pair, coloured), left, right)
    return jnp.sum(value)


def _range(pair: Pair) -> tuple[Array, Array]:
    """Ends of y = log tan(theta_m): D outlasts the power law of S by e^-60."""
    log_beta = jnp.log(pair.beta)
    fall = 60 + (pair.c + 1) * jnp.log1p(pair.B)
    low = jnp.minimum(log_beta, -jnp.log1p(pair.B)) - TAIL
    return low, jnp.minimum(log_beta + jnp.log(fall + 3 / pair.p * jnp.log(fall)) / (2 * pair.p), 30.0)


def _panels(f: Callable[[Array], Array], left: Array, right: Array) -> tuple[Array, Array]:
    """Kronrod's integral and its difference to Gauss', for panels (N,)."""
    half = (right - left) / 2
    values = f((left + right)[:, None] / 2 + half[:, None] * KRONROD)
    return half * (values @ WEIGHTS_15), jnp.abs(half * (values @ (WEIGHTS_15 - WEIGHTS_7)))


def _mesh(f: Callable[[Array], Array], low: Array, high: Array) -> tuple[Array, Array]:
    """Panels (PANELS,), the worst halved until the errors are small or all panels are used; idle ones are points."""
    edges = low + (high - low) * np.linspace(0, 1, FIRST + 1)
    pad = jnp.broadcast_to(high, (PANELS - FIRST,))
    left, right = jnp.concatenate([edges[:-1], pad]), jnp.concatenate([edges[1:], pad])
    value, error = (jnp.concatenate([x, 0 * pad]) for x in _panels(f, left[:FIRST], right[:FIRST]))

    def unfinished(state: tuple[Array, ...]) -> Array:
        _, _, value, error, used = state
        return (used < PANELS) & (jnp.sum(error) > TOLERANCE * jnp.sum(value))

    def halve(state: tuple[Array, ...]) -> tuple[Array, ...]:
        left, right, value, error, used = state
        worst = jnp.argmax(error)
        middle = (left[worst] + right[worst]) / 2
        a, b = jnp.stack([left[worst], middle]), jnp.stack([middle, right[worst]])
        where = jnp.stack([worst, used])
        new_value, new_error = _panels(f, a, b)
        return (
            left.at[where].set(a), right.at[where].set(b), value.at[where].set(new_value),
            error.at[where].set(new_error), used + 1,
        )  # fmt: skip

    left, right, *_ = jax.lax.while_loop(unfinished, halve, (left, right, value, error, jnp.asarray(FIRST)))
    return left, right


def _rings(y: Array, pair: Pair, coloured: bool) -> Array:
    """Integrand over y = log tan(theta_m): the rings' azimuth integrals times P22 tan^2 / cos_m."""
    tan = jnp.exp(y)
    cos_m = 1 / jnp.sqrt(1 + tan * tan)
    sin_m = tan * cos_m
    exponent = jnp.exp(jnp.minimum(2 * pair.p * (y - jnp.log(pair.beta)), 6.6))
    density = jnp.exp(log_p22_peak(pair.beta, pair.p) - exponent + 2 * y) / cos_m
    return density * _ring(sin_m, cos_m, pair, coloured)


def _ring(sin_m: Array, cos_m: Array, pair: Pair, coloured: bool) -> Array:
    """Integral over the azimuth of m, counted from h, of Q/2 (1 - A) S (i.m)+ (o.m)+."""
    sin_h, cos_h = pair.sin_h, pair.cos_h
    phi, weight = _azimuths(sin_m, cos_m, pair)
    sin_m, cos_m = sin_m[..., None], cos_m[..., None]
    half = jnp.sin(phi / 2) ** 2
    # 1 - cos(psi) and the component of m across h, without cancellation near h
    versed = (sin_h * cos_m - cos_h * sin_m) ** 2 / (1 + cos_h * cos_m + sin_h * sin_m) + 2 * sin_h * sin_m * half
    cos_psi = 1 - versed
    across = cos_h * sin_m - sin_h * cos_m - 2 * cos_h * sin_m * half
    tilt = pair.sin_d_cos * across + pair.sin_d_sin * sin_m * jnp.sin(phi)
    even = pair.cos_d * cos_psi
    # i and o are symmetric about h: i.m and o.m are even +- tilt
    i_m, o_m = even + tilt, even - tilt
    seen = (i_m > 0) & (o_m > 0)
    i_m, o_m = jnp.where(seen, i_m, 1.0), jnp.where(seen, o_m, 1.0)
    value = i_m * o_m * jnp.exp(-(pair.c + 1) / 2 * jnp.log1p(pair.B**2 * versed * (2 - versed)))
    value *= -jnp.expm1(-pair.phase * cos_psi**2)
    if coloured:
        dot = jnp.where(seen, 2 * pair.cos_d**2 - 1 - i_m * o_m, 0.0)
        value *= diffraction_colour(jnp.minimum(i_m, 1.0), jnp.minimum(o_m, 1.0), dot, pair.n, pair.k)
    return jnp.sum(jnp.where(seen, value, 0.0) * weight, -1)


def _azimuths(sin_m: Array, cos_m: Array, pair: Pair) -> tuple[Array, Array]:
    """Azimuths in (-pi, pi) and weights, (..., 6 BETWEEN_CUTS): Gauss nodes between cuts, in s of phi = w sinh(s)."""
    sin_h, cos_h = pair.sin_h, pair.cos_h
    product = sin_h * sin_m
    offset = (sin_m * cos_h - cos_m * sin_h) ** 2 + 1 / (1 + pair.B**2)
    width = jnp.minimum(safe_sqrt(safe_divide(offset, product)) + 1e3 * (product == 0), 1e3)
    cuts = [jnp.full_like(sin_m, -jnp.pi), jnp.zeros_like(sin_m), jnp.full_like(sin_m, jnp.pi)]
    for sign in (1, -1):  # i, o: cosine along n, and the projection's length and azimuth
        along = pair.cos_d * sin_h + sign * pair.sin_d_cos * cos_h
        beside = sign * pair.sin_d_sin
        cosine = pair.cos_d * cos_h - sign * pair.sin_d_cos * sin_h
        length = safe_sqrt(along**2 + beside**2)
        reach = safe_acos(jnp.clip(safe_divide(-cosine * cos_m, length * sin_m), -1.0, 1.0))
        azimuth = jnp.arctan2(beside, jnp.where((along == 0) & (beside == 0), 1.0, along))
        for end in (azimuth - reach, azimuth + reach):
            cuts.append(jnp.where(length > 0, (end + jnp.pi) % (2 * jnp.pi) - jnp.pi, 0.0))
    # the cuts move with the parameters of the directions only, and the integrand vanishes at them
    s = jnp.arcsinh(jnp.sort(jax.lax.stop_gradient(jnp.stack(cuts, -1)), -1) / width[..., None])
    nodes, weights = gauss_legendre(BETWEEN_CUTS)
    start, size = s[..., :-1, None], jnp.diff(s, axis=-1)[..., None]
    s = (start + size * nodes).reshape(*sin_m.shape, -1)
    weight = (size * weights).reshape(*sin_m.shape, -1)
    return width[..., None] * jnp.sinh(s), width[..., None] * jnp.cosh(s) * weight
