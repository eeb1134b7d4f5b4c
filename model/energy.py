"""The conserving split of the energy: no material gives back more light than it receives.

HP17 Eq. 25 leaves A_spec(theta_d) of the specular light to the facets' mirror term. Towards grazing angles the
diffraction lobe takes more than the rest. Here, in three steps, each the same for light and viewer exchanged:

1. **On the facet** the mirror term keeps 1 - E(theta_d). E is the albedo, at |F| = 1, of the facet's own diffraction
   lobe for light at theta_d (:func:`lobe_albedo`).
2. **On the surface** all lobes are divided by max(1, E(theta_i)) max(1, E(theta_o)). E is the albedo of the surface's
   lobes (`two_scale.TwoScale.surface_albedo`), which exceeds 1 as Eq. 33 drops the facets' foreshortening, as Q/2 of a
   metal has no bound at grazing angles, or without masking.
3. **Under the surface** a body gets T(theta_i), and gives back T(theta_o) over the mean of T, with T = 1 - min(1, E):
   what the surface lets through, as in Kelemen & Szirmay-Kalos 2001.

Both albedos are quadratures, tabulated and interpolated; they have slopes in every parameter, and kinks where max()
changes sides.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from . import body, chebyshev, diffraction, piecewise
from .geometry import Geometry
from .materialised import materialised, true_of
from .numerics import Real, Scalar, safe_acos, safe_divide, safe_sqrt
from .quadrature import gauss_legendre

SHARES = 24  # nodes of the renormalisation as a function of the facet's incidence: 1e-5
LOBE_INCIDENCES = 24  # nodes of a facet's lobe albedo: see `lobe_albedo`
LOBE_RADII, LOBE_HALF_RING = 20, 8  # Gauss nodes: of the complete inner disc and of the cut rings each; of half a ring
INCIDENCES = 48  # nodes of the surface's albedo
ORDER = 24  # of the convolution in the surface's albedo
RADII = (18, 32, 48, 32)  # Gauss nodes in log tan(theta_h): below, around, beyond the edge of D, and above 45 degrees
HALF_RING = 8  # Gauss nodes of half a ring of half vectors, up to the viewer's horizon
STEEPEST = np.radians(89.9)  # the largest theta_h of the surface's albedo


def share_curve(b_over_lambda: Array, c: Scalar) -> Array:
    """sigma_rel^2/sigma_s^2 (`diffraction.renormalisation`) as a table over 1 - sin(theta_d), (SHARES, C).

    The variable is asinh(b/lambda (1 - sin)): the share falls where the lobe's centre is within its width of the rim.
    Nodes are placed as b is now, so that they need no derivative.
    """
    placed = jax.lax.stop_gradient(b_over_lambda)
    gap = jnp.sinh(chebyshev.nodes(SHARES)[:, None] * jnp.arcsinh(placed)) / placed
    return diffraction.renormalisation(1 - gap, jnp.broadcast_to(b_over_lambda, gap.shape), c)


def share_of(b_over_lambda: Array, c: Scalar, table: Array | None = None) -> Callable[[Array], Array]:
    """The function of 1 - sin(theta_d), (C, ...), that :func:`share_curve` tabulates, per channel (C,)."""
    placed = jax.lax.stop_gradient(b_over_lambda)
    longest = jnp.arcsinh(placed)  # (C,)
    values = share_curve(b_over_lambda, c) if table is None else table

    def share(one_minus_sin: Array) -> Array:  # (C, ...)
        along = (-1, *(1,) * (one_minus_sin.ndim - 1))
        places = materialised(_place, true_of(longest[0]), placed.reshape(along), longest.reshape(along), one_minus_sin)
        return chebyshev.evaluate(values.reshape(SHARES, *along), places)

    return share


def _place(b_over_lambda: Real, longest: Real, one_minus_sin: Real) -> Real:
    """In [0, 1], among the nodes of `share_curve`."""
    return jnp.arcsinh(b_over_lambda * one_minus_sin) / longest


def lobe_albedo(theta_d: Real, table: Array) -> Array:
    """E at incidences on the facet (rad), of any shape, from :func:`lobe_albedo_table`: (C, *theta_d.shape)."""
    x = jnp.asarray(theta_d) * (2 / jnp.pi)
    return chebyshev.evaluate(table.T.reshape(LOBE_INCIDENCES, -1, *(1,) * x.ndim), x)


def lobe_albedo_table(
    b_um: Scalar, c: Scalar, sigma_s: Scalar, wavelength_um: Array, renormalised: bool, exact: bool
) -> Array:
    """E(theta_d): directional albedo at |F| = 1 of a facet's own diffraction lobe, per wavelength.

    E = Int over |o_p| <= 1 of (1 - A) S_HS(|i_p + o_p|/lambda) d^2 o_p for light at theta_d from the facet's normal.
    The facet sees what the model makes of it: sigma_rel and A at half the angle between i and o; with the approximation
    1 - A = (1 - A_spec) cos^2(theta_h) of HP17 Eq. 30 unless ``exact``, when A is that of Eq. 23.

    Args:
        b_um, sigma_s: micrometres. c: falloff of the spectrum. wavelength_um: (C,), or with more axes of length one.
        renormalised: whether sigma_rel and the lobe's amplitude are renormalised (Eq. 17-19).

    Returns:
        at the Chebyshev nodes of theta_d/(pi/2), (C, LOBE_INCIDENCES). Accuracy of :func:`lobe_albedo`: 5e-4
        (``tests/model/test_energy.py``); 2e-3 at b/lambda > 100, or where c > 4 and sigma_s > lambda/2 beyond 75
        degrees (8.7e-4 at b/lambda 42, c 4.4, sigma_s 0.8 lambda, 77 degrees).

    The plane of projected directions, polar around the lobe's centre: radius r = sinh(t)/(b/lambda); the complete disc
    r < 1 - s, and the rings cut by the horizon, s = sin(theta_d). Nodes of the azimuth, counted from the nearest point
    of the horizon, crowd where the ring crosses it and cos_o has its root.
    """
    wavelengths = wavelength_um.reshape(-1)
    b_over_lambda, sigma_over_lambda = b_um / wavelengths, sigma_s / wavelengths
    theta = np.pi / 2 * chebyshev.nodes(LOBE_INCIDENCES)[:, None]
    s, cos_i = jnp.sin(theta), jnp.cos(theta)
    gap = 2 * jnp.sin((np.pi / 2 - theta) / 2) ** 2  # 1 - s
    bl = b_over_lambda[:, None, None]
    u, w = gauss_legendre(LOBE_RADII)
    crowded, dcrowded = np.sin(np.pi / 2 * u) ** 2, w * np.pi / 2 * np.sin(np.pi * u)
    inner, outer = jnp.arcsinh(bl * gap), jnp.arcsinh(bl * (1 + s))
    t = jnp.concatenate([inner * u, inner + (outer - inner) * crowded], -1)[..., None]
    dt = jnp.concatenate([inner * w, (outer - inner) * dcrowded], -1)
    bl, s, cos_i, gap = bl[..., None], s[..., None], cos_i[..., None], gap[..., None]
    r = jnp.sinh(t) / bl
    # 1 - |o_p|^2 = 1 - s^2 - r^2 - 2 s r cos(azimuth)
    v, wv = gauss_legendre(LOBE_HALF_RING)
    ahead = safe_acos(jnp.clip(safe_divide(gap * (1 + s) - r * r, 2 * s * r), -1.0, 1.0))
    azimuth = ahead + (jnp.pi - ahead) * v**2
    cos_o = safe_sqrt(gap * (1 + s) - r * r - 2 * s * r * jnp.cos(azimuth))
    cos_2d = cos_i * cos_o - s * (s + r * jnp.cos(azimuth))
    cos2_d = (1 + cos_2d) / 2
    cos2_h = jnp.clip(safe_divide((cos_i + cos_o) ** 2, 4 * cos2_d), 0.0, 1.0)
    share = jnp.ones(())
    if renormalised:
        share = share_of(b_over_lambda, c)(cos2_d / (1 + safe_sqrt(1 - cos2_d)))
    phase = diffraction.phase_variance(
        share * sigma_over_lambda[:, None, None, None] ** 2, safe_sqrt(cos2_d), jnp.ones(())
    )
    taken = -jnp.expm1(-phase * cos2_h) if exact else -jnp.expm1(-phase) * cos2_h
    ring = jnp.sum(taken / share * 2 * (jnp.pi - ahead) * (2 * v * wv), -1)
    # amplitude (1 + bl^2 r^2)^(-(c+1)/2) r dr, in t
    return jnp.sum(ring * (c - 1) / (2 * jnp.pi) * jnp.tanh(t[..., 0]) * jnp.cosh(t[..., 0]) ** (1 - c) * dt, -1)


def incidences(beta: Scalar) -> Array:
    """Nodes of incidence (rad), (INCIDENCES,), even in `_position`, by bisection; constants for differentiation."""
    wanted = jnp.arange(float(INCIDENCES))

    def halve(_: Array | int, between: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = between
        middle = (low + high) / 2
        beyond = _position(middle, beta) > wanted
        return jnp.where(beyond, low, middle), jnp.where(beyond, middle, high)

    ends = jnp.zeros(INCIDENCES), jnp.full(INCIDENCES, np.pi / 2)
    return jax.lax.stop_gradient(jax.lax.fori_loop(0, 50, halve, ends)[0])


def _position(theta: Real, beta: Scalar) -> Real:
    """Where an incidence lies among the nodes, as beta is now: 0 is the first, within 0.1 degrees of the normal.

    Even in 1 - sqrt(cos) plus 1 - 1/(1 + sqrt(beta tan)), from 0 to 2, in which a surface's albedo is smooth: the first
    resolves Fresnel's rise, the second masking, whatever the width beta (see `masking.smith.masking`).
    """
    theta = jnp.clip(theta, 0.0, np.pi / 2 - 1e-9)
    root = safe_sqrt(jax.lax.stop_gradient(beta) * jnp.tan(theta))
    return (1 - jnp.sqrt(jnp.cos(theta)) + root / (1 + root)) * INCIDENCES / 2 - 0.02


def slopes(beta: Scalar, p: Scalar, largest_B: Scalar) -> tuple[Array, Array]:
    """Nodes in log tan(theta_h) for the lobes of one surface, around the edge of D, and their weights.

    Args:
        beta, p: the EPD. largest_B: 2 b/lambda of the narrowest lobe.
    """
    log_beta = jnp.log(beta)
    high = float(np.log(np.tan(STEEPEST)))
    low = jnp.minimum(log_beta, -jnp.log1p(largest_B)) - 5.0
    edge = log_beta + jnp.minimum(jnp.log(34 + 3 / p) / (2 * p), 2.0)
    edges = [low, log_beta - 1.0, jnp.minimum(edge, high), jnp.clip(edge, 0.0, high), high]
    return panels(edges, RADII)


def panels(edges: Sequence[Array | float], counts: Sequence[int]) -> tuple[Array, Array]:
    """Gauss nodes and weights between neighbouring edges, so many each."""
    rules = [gauss_legendre(n) for n in counts]
    y = jnp.concatenate([a + (b - a) * u for a, b, (u, _) in zip(edges, edges[1:], rules, strict=False)])
    return y, jnp.concatenate([(b - a) * w for a, b, (_, w) in zip(edges, edges[1:], rules, strict=False)])


def half_vectors(theta_i: Real, y: Array, dy: Array, azimuths: int = HALF_RING) -> tuple[Geometry, Array]:
    """Half vectors for light at the angles ``theta_i`` (rad), (A,), and the measure cos_o domega_o of their viewers.

    The same theta_h for every incidence. Azimuths from the plane of incidence to where the viewer sets,
    at cos(phi) = -cot(theta_i) cot(2 theta_h).

    Args:
        y, dy: nodes in log tan(theta_h), and their weights, (R,): an edge of panels is at 45 degrees, from where on
            all viewers set at once at normal incidence. azimuths: nodes of half a ring.

    Returns:
        geometry with theta_h ``(1, R, 1)`` and the rest ``(A, R, azimuths)``; measure of that shape.
    """
    theta_i = theta_i[:, None, None]
    tan_h = jnp.exp(y)[None, :, None]
    theta_h = jnp.arctan(tan_h)
    sin_h, cos_h = jnp.sin(theta_h), jnp.cos(theta_h)
    sin_i, cos_i = jnp.sin(theta_i), jnp.cos(theta_i)
    v, w = gauss_legendre(azimuths)
    sets = -cos_i * (cos_h**2 - sin_h**2) / (2 * sin_i * sin_h * cos_h)
    end = safe_acos(jnp.clip(sets, -1.0, 1.0))
    phi, dphi = end * v, end * w
    cos_d = cos_i * cos_h + sin_i * sin_h * jnp.cos(phi)
    cos_o = 2 * cos_d * cos_h - cos_i
    seen = (cos_o > 0) & (cos_d > 0)
    cos_d, cos_o = jnp.where(seen, cos_d, 1.0), jnp.where(seen, cos_o, 1.0)
    measure = jnp.where(seen, cos_o * 4 * cos_d * sin_h**2 * cos_h * dy[:, None] * 2 * dphi, 0.0)
    return Geometry(theta_h, safe_acos(cos_d), jnp.broadcast_to(cos_i, cos_d.shape), cos_o), measure


def at_incidence(table: Array, beta: Scalar, theta: Real, masked: bool) -> Array:
    """A table over the nodes of incidence, (C, INCIDENCES), at angles ``theta``: shape (C, *theta.shape).

    Of log(1 + E), which is tame where masking is off and E grows as 1/cos. Beyond the outermost nodes, within 0.1
    degrees of the normal and of the horizon, it stays what it is there; near the horizon it goes on as 1/cos unless
    ``masked``.
    """
    theta = jnp.asarray(theta)
    albedo = jnp.expm1(piecewise.interpolate(jnp.log1p(table), _position(theta, beta)))
    if masked:
        return albedo
    return albedo * jnp.maximum(jnp.cos(incidences(beta)[-1]) / jnp.maximum(jnp.cos(theta), 1e-9), 1.0)


def mean_transmittance(table: Array, beta: Scalar, masked: bool) -> Array:
    """Int (1 - min(1, E)) cos domega / pi of a table over the nodes of incidence, (C,)."""
    u, w = gauss_legendre(64)
    theta = np.pi / 2 * u
    through = jnp.maximum(1 - at_incidence(table, beta, jnp.asarray(theta), masked), 0.0)
    return jnp.sum(through * (np.pi / 2 * w * 2 * np.sin(theta) * np.cos(theta)), -1)


def unlit_body(kind: str, cos_i: Real, cos_o: Real, albedo: Real, n: Real | None) -> Array:
    """A body's BRDF without the transmittances T(i) T(o) and times their mean: (1/sr).

    With T(i) T(o) over the mean of T its directional albedo is at most T(i). ``lambert``: rho_d/pi; ``plastic``: the
    net albedo rho_d (1 - r_e)/(eta^2 (1 - r_i rho_d)) over pi, 1 at rho_d = 1; ``subsurface``: what HP17 Eq. 44-47 give
    back, divided by its excess over 1 at grazing incidence, where it is largest.
    """
    if kind == "lambert" or n is None:
        return body.lambert(albedo)
    leaving = 1 - body.external_diffuse_reflectance(n)
    inside = 1 - leaving / n**2
    if kind == "plastic":
        return albedo * leaving / (jnp.pi * n**2 * (1 - inside * albedo))
    u, w = gauss_legendre(16)
    along = u.reshape(-1, *(1,) * jnp.ndim(n))
    grazing = body.scattered(jnp.zeros(()), jnp.asarray(along), n, albedo, inside)
    most = leaving * jnp.tensordot(2 * np.pi * u * w, grazing, 1)
    return leaving * body.scattered(cos_i, cos_o, n, albedo, inside) / jnp.maximum(most, 1.0)
