"""Colour of the two lobes: Fresnel reflectance F and the Rayleigh-Rice diffraction factor Q.

All complex arithmetic of HP17 Eq. 3-4 and 10 is written out in reals, which compiles to loops that vectorise and keeps
gradients finite at ``k = 0``. ``n`` and ``k`` are the real and imaginary part of the index of refraction.
"""

from typing import NamedTuple

import jax.numpy as jnp

from .numerics import Real, safe_divide, safe_sqrt


class Transmitted(NamedTuple):
    """Functions of one direction that F and Q are made of (HP17 Eq. 4 and 10); ``c = sqrt(eta^2 - sin^2 theta)``."""

    perpendicular: Real  # 1 / |cos + c|^2
    parallel: Real  # 1 / |eta^2 cos + c|^2
    c_real: Real
    c_imag: Real


def _contrast(n: Real, k: Real) -> tuple[Real, Real]:
    """Real and imaginary part of eta^2 - 1, without cancellation for an index near 1."""
    return (n - 1) * (n + 1) - k**2, 2 * n * k


def refracted_cosine(cos_theta: Real, n: Real, k: Real) -> tuple[Real, Real]:
    """Real and imaginary part of ``c = sqrt(eta^2 - sin^2 theta)`` (principal branch), HP17 Eq. 3.

    The gradient is finite everywhere; at the critical angle of a real index below one it is set to zero.
    """
    real, imag = _contrast(n, k)
    real = real + cos_theta**2
    # sqrt of the modulus; the smaller of the two parts comes from the product, not from a difference
    modulus = safe_sqrt(real**2 + imag**2)
    larger = safe_sqrt((modulus + jnp.abs(real)) / 2)
    smaller = safe_divide(imag, 2 * larger)
    outside = real >= 0
    return jnp.where(outside, larger, smaller), jnp.where(outside, smaller, larger)


def transmitted(cos_theta: Real, n: Real, k: Real) -> Transmitted:
    """The one-direction factors of F and Q for an index ``n + i k``; arrays broadcast."""
    c_real, c_imag = refracted_cosine(cos_theta, n, k)
    eta2_real, eta2_imag = (n - k) * (n + k), 2 * n * k
    perpendicular = safe_divide(1.0, (cos_theta + c_real) ** 2 + c_imag**2)
    parallel = safe_divide(1.0, (eta2_real * cos_theta + c_real) ** 2 + (eta2_imag * cos_theta + c_imag) ** 2)
    return Transmitted(perpendicular, parallel, c_real, c_imag)


def fresnel(cos_theta: Real, n: Real, k: Real) -> Real:
    """Unpolarised Fresnel reflectance in [0, 1] (HP17 Eq. 3-4), exact.

    The differences of Eq. 4 are written as products, (cos - c)(cos + c) = 1 - eta^2 and (eta^2 cos - c)(eta^2 cos + c)
    = (eta^2 - 1)(eta^2 cos^2 - sin^2), so that no digit is lost for an index near 1; it is 0 for an index of 1.

    Args:
        cos_theta: cosine of the angle of incidence; broadcasts with the index.
        n: real part of the index of refraction, relative to the outside.
        k: imaginary part; 0 for a dielectric.

    Accuracy: 1e-12 against 30 digits (``tests/model/test_fresnel.py``).
    """
    t = transmitted(cos_theta, n, k)
    contrast_real, contrast_imag = _contrast(n, k)
    cos2 = cos_theta**2
    tilted = (contrast_real * cos2 + 2 * cos2 - 1) ** 2 + (contrast_imag * cos2) ** 2  # |eta^2 cos^2 - sin^2|^2
    return (contrast_real**2 + contrast_imag**2) * (t.perpendicular**2 + tilted * t.parallel**2) / 2


def schlick(cos_theta: Real, n: Real, k: Real) -> Real:
    """Schlick's approximation F0 + (1 - F0)(1 - cos)^5, F0 that of the index ``n + i k``; arguments as `fresnel`."""
    return schlick_of_F0(cos_theta, ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2))


def schlick_of_F0(cos_theta: Real, F0: Real) -> Real:
    """The same from the reflectance at normal incidence."""
    return F0 + (1 - F0) * (1 - cos_theta) ** 5


def diffraction_colour(cos_i: Real, cos_o: Real, projected_dot: Real, n: Real, k: Real) -> Real:
    """Colour of the diffraction lobe, Q/2 of Rayleigh-Rice (HP17 Eq. 10), dimensionless.

    HP17 prints Q, which is twice the Fresnel reflectance in the mirror direction; unpolarised light averages over two
    incident states, hence Q/2 (``docs/physics.md``, erratum). Equals :func:`fresnel` where o is the mirror of i.

    Args:
        cos_i, cos_o: cosines of light and viewer.
        projected_dot: sin_i sin_o cos(phi_o - phi_i), dot product of the two projected directions.
        n, k: index of refraction.
    """
    i, o = transmitted(cos_i, n, k), transmitted(cos_o, n, k)
    eta2_real, eta2_imag = (n - k) * (n + k), 2 * n * k
    sin2_sin2 = (1 - cos_i**2) * (1 - cos_o**2)
    # cos^2 phi; at normal incidence Q does not depend on it and any value serves
    cos2_phi = jnp.clip(safe_divide(projected_dot**2, sin2_sin2), 0.0, 1.0)
    b_i = (i.c_real**2 + i.c_imag**2) * i.parallel
    b_o = (o.c_real**2 + o.c_imag**2) * o.parallel
    # Re(c_i c_o conj(eta^2))
    product_real = i.c_real * o.c_real - i.c_imag * o.c_imag
    product_imag = i.c_real * o.c_imag + i.c_imag * o.c_real
    interference = product_real * eta2_real + product_imag * eta2_imag
    same = cos2_phi * (i.perpendicular * o.perpendicular + b_i * b_o)
    crossed = (1 - cos2_phi) * (i.perpendicular * b_o + b_i * o.perpendicular)
    # cos(phi) sin_i sin_o is minus the projected dot product: phi is counted from the mirror direction
    plane = i.parallel * o.parallel * ((eta2_real**2 + eta2_imag**2) * sin2_sin2 + 2 * projected_dot * interference)
    contrast_real, contrast_imag = _contrast(n, k)
    return (contrast_real**2 + contrast_imag**2) * (same + crossed + plane) / 2


def fresnel_of_dielectric(cos_d: Real, eta: Real) -> Real:
    """:func:`fresnel` without an imaginary part of the index: half of its arithmetic.

    Accuracy: 2e-15 against :func:`fresnel` (``tests/model/test_fresnel.py``). Past the critical angle of an index below
    one it is 1, with gradient zero.
    """
    contrast, cos2 = (eta - 1) * (eta + 1), cos_d**2
    c = safe_sqrt(jnp.abs(contrast + cos2))
    perpendicular, parallel = safe_divide(1.0, (cos_d + c) ** 2), safe_divide(1.0, (eta**2 * cos_d + c) ** 2)
    tilted = (contrast * cos2 + 2 * cos2 - 1) ** 2
    reflected = contrast**2 * (perpendicular**2 + tilted * parallel**2) / 2
    return jnp.where(contrast + cos2 >= 0, reflected, 1.0)


def schlick_of_dielectric(cos_d: Real, eta: Real) -> Real:
    """The same by Schlick's polynomial."""
    return schlick(cos_d, eta, jnp.zeros_like(eta))
