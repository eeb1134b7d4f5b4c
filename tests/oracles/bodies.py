"""Light that enters the material: plastic (IL Eq. 8, HP17 Eq. 42-43) and subsurface (HP17 Eq. 44-47), with the errata.

The diffuse Fresnel reflectances are plain integrals; the layer model counts bounces one by one.
"""

import math
from functools import cache

import mpmath as mp
from scipy.integrate import quad

from .fresnel import fresnel


def _cosine_average(reflectance, kinks):
    """2 Int_0^1 reflectance(mu) mu dmu, split at `kinks`; tanh-sinh takes the square root at a critical angle."""
    with mp.workdps(20):
        pieces = [mp.mpf(0), *kinks, mp.mpf(1)]
        return float(2 * mp.quad(lambda mu: mp.mpf(reflectance(mu)) * mu, pieces))


@cache
def internal_diffuse_reflectance(eta):
    """r_i: diffuse light from inside the medium of real index eta >= 1 (IL Eq. 9), total reflection included. 1e-12."""
    return _cosine_average(lambda mu: fresnel(mu, 1 / eta), [mp.sqrt(1 - 1 / mp.mpf(eta) ** 2)] if eta > 1 else [])


def external_diffuse_reflectance(eta):
    """r_e: diffuse light from outside. To 1e-12. Etendue ties the two: eta^2 (1 - r_i) = 1 - r_e."""
    return _cosine_average(lambda mu: fresnel(mu, eta), [])


def external_diffuse_reflectance_closed(eta):
    """r_e in closed form, IL Eq. 10. Cancels as eta tends to 1: use eta > 1.01 in floats."""
    n = eta
    return (
        1 / 2
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
        + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * math.log(n)
        + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * math.log((n - 1) / (n + 1))
    )


def transmission(theta_i, theta_o, eta):
    """T = (1 - F(theta_i)) (1 - F(theta_o)), HP17 Eq. 42."""
    return (1 - fresnel(math.cos(theta_i), eta)) * (1 - fresnel(math.cos(theta_o), eta))


def plastic(theta_i, theta_o, eta, rho_d):
    """A Lambertian base of albedo rho_d under a clear varnish: T rho_d / (pi eta^2 (1 - r_i rho_d)), IL Eq. 8.

    HP17 Eq. 43 as printed has rho_d/pi inside the bounce series and lacks the 1/eta^2 of leaving a denser medium.
    """
    bounces = 1 - internal_diffuse_reflectance(eta) * rho_d
    return transmission(theta_i, theta_o, eta) * rho_d / (math.pi * eta**2 * bounces)


def plastic_layers(theta_i, eta, rho_d, bounces=4000):
    """(reflected at the surface, escaped from the body, absorbed) per unit of incident flux, bounce by bounce."""
    surface = fresnel(math.cos(theta_i), eta)
    r_i = internal_diffuse_reflectance(eta)
    inside, escaped, absorbed = 1 - surface, 0.0, 0.0
    for _ in range(bounces):
        absorbed += inside * (1 - rho_d)
        inside *= rho_d
        escaped += inside * (1 - r_i)
        inside *= r_i
    return surface, escaped, absorbed


def albedo(brdf, theta_i):
    """Directional albedo of an azimuth-free brdf(theta_i, theta_o): 2 pi Int brdf cos sin dtheta_o, to 1e-9."""
    value, _ = quad(lambda t: brdf(theta_i, t) * math.sin(2 * t), 0, math.pi / 2, epsabs=0, epsrel=1e-9, limit=200)
    return math.pi * value


def boundary_factor(f_dr):
    """A_F = (1 + F_dr)/(1 - F_dr) for an internal diffuse reflectance f_dr; HP17 Eq. 45 is printed upside down."""
    return (1 + f_dr) / (1 - f_dr)


def diffusion_multi(transmitted, alpha, boundary):
    """Multiple scattering, HP17 Eq. 46, for a boundary factor A_F."""
    depth = math.sqrt(3 * (1 - alpha))
    return alpha * transmitted / (2 * math.pi) * math.exp(-depth) * (1 + math.exp(-4 / 3 * boundary * depth))


def subsurface(theta_i, theta_o, eta, alpha):
    """Single plus multiple scattering in a medium of albedo alpha under a flat interface, HP17 Eq. 44-47.

    F_dr is the internal diffuse reflectance (Jensen 2001), by integration. Not bounded by 1: as alpha tends to 1 the
    multiple scattering alone spends what was transmitted, and the single scattering comes on top (up to 1.15 in all).
    """
    transmitted = transmission(theta_i, theta_o, eta)
    inner = [math.sqrt(1 - (math.sin(theta) / eta) ** 2) for theta in (theta_i, theta_o)]
    single = alpha * transmitted / (4 * math.pi) / sum(inner)
    return single + diffusion_multi(transmitted, alpha, boundary_factor(internal_diffuse_reflectance(eta)))
