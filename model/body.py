"""What lies under the interface: bodies that light enters, is scattered in, and leaves (HP17 Section 4.5).

All return a BRDF (1/sr) without the surface lobes. ``n`` is the real index of the interface relative to the outside.
"""

import jax.numpy as jnp

from .fresnel import fresnel
from .numerics import Real, safe_sqrt
from .quadrature import gauss_legendre

DIFFUSE_ORDER = 64  # 1e-9 for n in [1, 4] (tests/model/test_against_oracles.py)


def external_diffuse_reflectance(n: Real) -> Real:
    """r_e: Fresnel reflectance of diffuse light from outside, Int F 2 cos sin dtheta (IL Eq. 10, by quadrature).

    The closed form of IL is 0/0 at n = 1; Gauss nodes in the square root of the cosine are not.
    """
    u, w = gauss_legendre(DIFFUSE_ORDER)
    cos = u**2
    reflectance = fresnel(jnp.asarray(cos), n[..., None], jnp.zeros(()))
    return jnp.sum(reflectance * 4 * u**3 * w, -1)


def internal_diffuse_reflectance(n: Real) -> Real:
    """r_i, F_dr: reflectance of diffuse light from inside, total reflection included; n^2 (1 - r_i) = 1 - r_e."""
    return 1 - (1 - external_diffuse_reflectance(n)) / n**2


def transmittance(cos_i: Real, cos_o: Real, n: Real) -> Real:
    """T = (1 - F(theta_i)) (1 - F(theta_o)), HP17 Eq. 42."""
    zero = jnp.zeros(())
    return (1 - fresnel(cos_i, n, zero)) * (1 - fresnel(cos_o, n, zero))


def lambert(albedo: Real) -> Real:
    """rho_d / pi: a diffuse term that does not know of the interface, as Cook-Torrance models add it.

    Together with the surface lobes it may reflect more than it receives; ``plastic`` and ``subsurface`` may not.
    """
    return albedo / jnp.pi


def plastic(cos_i: Real, cos_o: Real, n: Real, albedo: Real) -> Real:
    """Diffuse base of reflectance ``albedo`` under a clear smooth layer, with all inter-reflections (HP17 Eq. 43).

    HP17 prints rho_d/pi inside the series and leaves out the 1/n^2 of rays leaving a denser medium; energy conservation
    and IL Eq. 8 give T(i) T(o) rho_d / (pi n^2 (1 - r_i rho_d)), used here. Reciprocal; never reflects more than 1.
    """
    r_i = internal_diffuse_reflectance(n)
    return transmittance(cos_i, cos_o, n) * albedo / (jnp.pi * n**2 * (1 - r_i * albedo))


def subsurface(cos_i: Real, cos_o: Real, n: Real, albedo: Real) -> Real:
    """Single and multiple scattering in a half space of single-scattering ``albedo`` (HP17 Eq. 44-47, Jensen 2001).

    HP17 Eq. 45 is printed inverted; A = (1 + F_dr)/(1 - F_dr), F_dr the internal diffuse reflectance.
    """
    refracted_i = safe_sqrt(1 - (1 - cos_i**2) / n**2)
    refracted_o = safe_sqrt(1 - (1 - cos_o**2) / n**2)
    f_dr = internal_diffuse_reflectance(n)
    boundary = (1 + f_dr) / (1 - f_dr)
    root = safe_sqrt(3 * (1 - albedo))
    single = 1 / (4 * jnp.pi * (refracted_i + refracted_o))
    multiple = jnp.exp(-root) * (1 + jnp.exp(-4 / 3 * boundary * root)) / (2 * jnp.pi)
    return albedo * transmittance(cos_i, cos_o, n) * (single + multiple)
