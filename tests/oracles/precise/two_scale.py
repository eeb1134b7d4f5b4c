"""The assembled model: lobes, body and apparatus, as the effects have them."""

from types import SimpleNamespace

import mpmath as mp

from .acquisition import derived_exponent, grazing
from .arithmetic import DIGITS
from .body import under
from .energy import conserved
from .lobes import Geometry, lobes

CHOICES = {
    "body": "none", "diffraction": "quadrature", "zonal_order": 100, "fresnel": "exact", "masking": "smith",
    "renormalised": True, "split": "printed", "colour": "rayleigh_rice", "acquisition": "off",
}  # fmt: skip


def two_scale(theta_h, theta_d, phi_d, wavelength_um, **rest):
    """The BRDF of HP17 Eq. 24-33 at half and difference angles: effects, as `CHOICES` has them else, and parameters.

    Under the conserving split lobes are not blurred, and the surface's albedo is an integral by fixed rules, to 1e-6.
    """
    with mp.workdps(DIGITS):
        at = _geometry(*(mp.mpf(x) for x in (theta_h, theta_d, phi_d)))
        wavelength_um = mp.mpf(wavelength_um)
        e = SimpleNamespace(**{name: rest.pop(name, choice) for name, choice in CHOICES.items()})
        v = SimpleNamespace(**{name: mp.mpf(x) for name, x in rest.items()})
        v.index = (v.n, v.k) if e.body == "none" else (v.eta, mp.mpf(0))
        if min(at.cos_i, at.cos_o) <= 0:
            return mp.mpf(0)
        surface, body = lobes(at, wavelength_um, v, e), under(at, v, e)
        if e.split == "conserving":
            surface, body = conserved(surface, body, at, wavelength_um, v, e)
        return (surface + body) * _loss(at, v, e)


def _geometry(theta_h, theta_d, phi_d):
    even, odd = mp.cos(theta_h) * mp.cos(theta_d), mp.sin(theta_h) * mp.sin(theta_d) * mp.cos(phi_d)
    return Geometry(theta_h, theta_d, phi_d, even - odd, even + odd)


def _loss(at, v, e):
    """The apparatus's loss at grazing angles; ``acquisition`` is a name or the exponent itself."""
    if e.acquisition == "off":
        return mp.mpf(1)
    k = {"free": lambda: v.grazing_exponent, "derived": lambda: derived_exponent(v.beta, v.p)}
    return grazing(at.cos_i, at.cos_o, k.get(e.acquisition, lambda: e.acquisition)())
