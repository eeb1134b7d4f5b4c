"""Bodies under the surface: Lambert, the smooth plastic and subsurface scattering."""

import mpmath as mp

from .arithmetic import DIGITS, exactly
from .colour import fresnel


@exactly
def external_diffuse_reflectance(n):
    """r_e in closed form (IL Eq. 10), digits enough for its cancellation."""
    if n == 1:
        return mp.mpf(0)
    with mp.workdps(4 * DIGITS):
        return (
            mp.mpf(1) / 2
            + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
            - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
            + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * mp.log(n)
            + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * mp.log((n - 1) / (n + 1))
        )


def _internal(n):
    return 1 - (1 - external_diffuse_reflectance(n)) / n**2


def _transmittance(cos_i, cos_o, n):
    return (1 - fresnel(cos_i, n, 0)) * (1 - fresnel(cos_o, n, 0))


@exactly
def lambert(albedo):
    """rho_d/pi."""
    return albedo / mp.pi


def _plastic(transmittance, n, albedo):
    """HP17 Eq. 43 with the erratum, T(i) T(o) given."""
    return transmittance * albedo / (mp.pi * n**2 * (1 - _internal(n) * albedo))


@exactly
def plastic(cos_i, cos_o, n, albedo):
    """HP17 Eq. 43 with the erratum."""
    return _plastic(_transmittance(cos_i, cos_o, n), n, albedo)


@exactly
def subsurface(cos_i, cos_o, n, albedo):
    """HP17 Eq. 44-47 with the erratum."""
    inner = sum(mp.sqrt(1 - (1 - cos**2) / n**2) for cos in (cos_i, cos_o))
    boundary = (1 + _internal(n)) / (1 - _internal(n))
    root = mp.sqrt(3 * (1 - albedo))
    multiple = mp.exp(-root) * (1 + mp.exp(-4 * boundary * root / 3)) / (2 * mp.pi)
    return albedo * _transmittance(cos_i, cos_o, n) * (1 / (4 * mp.pi * inner) + multiple)


def under(at, v, e):
    """The body of effects e and parameters v.

    The conserving split's is without the transmittances T(i) T(o), times their mean; ``subsurface`` has none.
    """
    if e.body == "none":
        return 0
    if e.body == "lambert":
        return lambert(v.albedo)
    if e.split == "conserving":
        return _plastic(1 - external_diffuse_reflectance(v.eta), v.eta, v.albedo)
    return (plastic if e.body == "plastic" else subsurface)(at.cos_i, at.cos_o, v.eta, v.albedo)
