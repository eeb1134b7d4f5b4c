"""What lies under the interface: bodies that light enters, is scattered in, and leaves (HP17 Section 4.5).

All return a BRDF (1/sr) without the surface lobes. ``n`` is the real index of the interface relative to the outside.
"""

import jax.numpy as jnp

from .fresnel import fresnel_of_dielectric
from .geometry import Geometry
from .numerics import Real, Scalar, safe_divide, safe_sqrt, total
from .quadrature import gauss_legendre

DIFFUSE_ORDER = 64  # 1e-12 for n in [1, 4] (tests/hard_cases/cases.toml)


def external_diffuse_reflectance(n: Real) -> Real:
    """r_e: Fresnel reflectance of diffuse light from outside, Int F 2 cos sin dtheta (IL Eq. 10), for n >= 1.

    The closed form of IL is 0/0 at n = 1, and any fixed nodes in the angle miss the slope 1/3 there, which comes from
    angles within sqrt(n^2 - 1) of grazing. In r = (c - cos)/(c + cos), c^2 = n^2 - 1 + cos^2, the amplitude of
    s-polarised light, with m = n^2 - 1, everything is rational:

        r_e = m/8 Int_((n-1)/(n+1))^1 [1 + ((m + 2 - m/r)/(m + 2 - m r))^2] (1 - r^2) dr.
    """
    u, w = (jnp.asarray(x, n.dtype) for x in gauss_legendre(DIFFUSE_ORDER))
    n = n[..., None]
    least, m = (n - 1) / (n + 1), (n - 1) * (n + 1)
    r = least + (1 - least) * u**3
    parallel = ((m + 2 - m / r) / (m + 2 - m * r)) ** 2
    return total((1 + parallel) * (1 - r) * (1 + r) * (1 - least) * 3 * u**2 * w * m / 8)


def internal_diffuse_reflectance(n: Real) -> Real:
    """r_i, F_dr: reflectance of diffuse light from inside, total reflection included; n^2 (1 - r_i) = 1 - r_e."""
    return 1 - (1 - external_diffuse_reflectance(n)) / n**2


def transmittance(cos_i: Real, cos_o: Real, n: Real) -> Real:
    """T = (1 - F(theta_i)) (1 - F(theta_o)), HP17 Eq. 42."""
    return (1 - fresnel_of_dielectric(cos_i, n)) * (1 - fresnel_of_dielectric(cos_o, n))


def lambert(albedo: Real) -> Real:
    """rho_d / pi: a diffuse term that does not know of the interface, as Cook-Torrance models add it.

    Together with the surface lobes it may reflect more than it receives, as every body may beside a diffraction lobe
    (results/energy.md); the split ``conserving`` mends that.
    """
    return albedo / jnp.pi


def lambert_of(cos_i: Real, cos_o: Real, n: Real, albedo: Real) -> Real:
    """:func:`lambert` with the arguments that other bodies have."""
    return lambert(albedo)


def plastic(cos_i: Real, cos_o: Real, n: Real, albedo: Real) -> Real:
    """Diffuse base of reflectance ``albedo`` under a clear smooth layer, with all inter-reflections (HP17 Eq. 43).

    HP17 prints rho_d/pi inside the series and leaves out the 1/n^2 of rays leaving a denser medium; energy conservation
    and IL Eq. 8 give T(i) T(o) rho_d / (pi n^2 (1 - r_i rho_d)), used here. Reciprocal; never reflects more than 1.
    """
    return transmittance(cos_i, cos_o, n) * substrate(n, albedo, internal_diffuse_reflectance(n))


def substrate(n: Real, albedo: Real, r_i: Real) -> Real:
    """albedo / (pi n^2 (1 - r_i albedo)), 1/sr (IL Eq. 8): a Lambertian base below its interface, all bounces.

    Args:
        r_i: `internal_diffuse_reflectance` of n.
    """
    return albedo / (jnp.pi * n**2 * (1 - r_i * albedo))


def scattered(cos_i: Real, cos_o: Real, n: Real, albedo: Real, f_dr: Real) -> Real:
    """Light that a half space of single-scattering ``albedo`` gives back inside its interface (HP17 Eq. 44-47), 1/sr.

    HP17 Eq. 45 is printed inverted; A = (1 + F_dr)/(1 - F_dr).

    Args:
        f_dr: `internal_diffuse_reflectance` of n.
    """
    refracted = [safe_sqrt((n - 1) * (n + 1) + cos**2) / n for cos in (cos_i, cos_o)]
    boundary = (1 + f_dr) / (1 - f_dr)
    root = safe_sqrt(3 * (1 - albedo))
    single = safe_divide(1.0, 4 * jnp.pi * (refracted[0] + refracted[1]))
    multiple = jnp.exp(-root) * (1 + jnp.exp(-4 / 3 * boundary * root)) / (2 * jnp.pi)
    return albedo * (single + multiple)


def subsurface(cos_i: Real, cos_o: Real, n: Real, albedo: Real) -> Real:
    """Single and multiple scattering in a half space of single-scattering ``albedo`` (HP17 Eq. 44-47, Jensen 2001).

    Gives back up to 1.38 of the light by itself, as albedo and index tend to 1; the split ``conserving`` mends it.
    """
    return transmittance(cos_i, cos_o, n) * scattered(cos_i, cos_o, n, albedo, internal_diffuse_reflectance(n))


def rough_lambert(g: Geometry, roughness: Scalar, albedo: Real) -> Real:
    """Rough Lambertian facets in V-cavities with interreflection (Oren & Nayar 1994, Eq. 14-16), 1/sr.

    With alpha and beta the larger and the smaller of theta_i and theta_o and phi the azimuth between them,

        albedo/pi [C1 + C2 cos(phi) tan(beta) + C3 (1 - |cos phi|) tan((alpha + beta)/2)]
        + 0.17 albedo^2/pi s2/(s2 + 0.13) (1 - cos(phi) (2 beta/pi)^2),    s2 = sigma^2;
        C1 = 1 - s2/(2 (s2 + 0.33)), C3 = 0.125 s2/(s2 + 0.09) (4 alpha beta/pi^2)^2,
        C2 = 0.45 s2/(s2 + 0.09) (sin(alpha) - [(2 beta/pi)^3 where cos(phi) < 0]).

    Opposite the light and near the horizon it is negative, down to -0.21 albedo/pi: to renderers it is 0 there.
    """
    square = roughness**2
    alpha, beta = jnp.maximum(g.theta_i, g.theta_o), jnp.minimum(g.theta_i, g.theta_o)
    sin_alpha, cos_beta = jnp.sin(alpha), jnp.maximum(g.cos_i, g.cos_o)
    cos_phi, share = g.cos_phi, square / (square + 0.09)
    behind = jnp.where(cos_phi < 0, (2 * beta / jnp.pi) ** 3, 0.0)
    C2 = 0.45 * share * (sin_alpha - behind)
    C3 = 0.125 * share * (4 * alpha * beta / jnp.pi**2) ** 2
    direct = 1 - square / (2 * (square + 0.33)) + C2 * cos_phi * jnp.sin(beta) / cos_beta
    direct = direct + C3 * (1 - jnp.abs(cos_phi)) * jnp.tan((alpha + beta) / 2)
    again = 0.17 * square / (square + 0.13) * (1 - cos_phi * (2 * beta / jnp.pi) ** 2)
    return albedo / jnp.pi * (direct + albedo * again)


def energy_preserving_oren_nayar(g: Geometry, roughness: Scalar, albedo: Real) -> Real:
    """Rough diffuse facets that lose no light (EON of Portsmouth, Kutz & Hill 2025), roughness in [0, 1], 1/sr.

    With s = sin_i sin_o cos(phi), t = max(cos_i, cos_o) where s > 0 and 1 elsewhere, A = 1/(1 + (1/2 - 2/(3 pi)) r):

        albedo/pi A (1 + r s/t) + albedo_m/pi (1 - E(cos_i)) (1 - E(cos_o)) / (1 - <E>)
        E = A (1 + r G/pi), <E> = A (1 + r (2/3 - 28/(15 pi))), albedo_m = albedo^2 <E>/(1 - albedo (1 - <E>)),

    E the albedo of the first term at an albedo of one: together they then give back all light, to the last digit.
    """
    A = 1 / (1 + (0.5 - 2 / (3 * jnp.pi)) * roughness)
    mean = A * (1 + roughness * (2 / 3 - 28 / (15 * jnp.pi)))
    s = g.projected_dot
    single = A * (1 + roughness * jnp.where(s > 0, s / jnp.maximum(g.cos_i, g.cos_o), s))
    # 1 - E and 1 - <E> vanish with r: both are written with r taken out
    lost_mean = A * (0.5 - 2 / (3 * jnp.pi) - 2 / 3 + 28 / (15 * jnp.pi))
    lost = [A * (0.5 - 2 / (3 * jnp.pi) - _fujii(cos, theta) / jnp.pi) for cos, theta in
            ((g.cos_i, g.theta_i), (g.cos_o, g.theta_o))]  # fmt: skip
    several = albedo * mean / (1 - albedo * roughness * lost_mean) * roughness * lost[0] * lost[1] / lost_mean
    return albedo / jnp.pi * (single + several)


def _fujii(cos: Real, theta: Real) -> Real:
    """G of the model above, sin (theta - sin cos) + 2/3 (tan (1 - sin^3) - sin), finite at the horizon."""
    sin = jnp.sin(theta)
    # (1 - sin^3)/cos = cos (1 + sin + sin^2)/(1 + sin)
    return sin * (theta - sin * cos) + 2 / 3 * sin * (cos * (1 + sin + sin**2) / (1 + sin) - 1)
