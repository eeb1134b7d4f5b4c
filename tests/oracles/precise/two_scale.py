"""The assembled model: lobes, body and apparatus, as the effects have them."""

from types import SimpleNamespace

import mpmath as mp

from .acquisition import derived_exponent, derived_exponent_diffracted, grazing
from .arithmetic import DIGITS
from .body import under
from .energy import conserved
from .lobes import Geometry, lobes

CHOICES = {
    "body": "none", "diffraction": "quadrature", "fresnel": "exact", "masking": "smith",
    "renormalised": True, "split": "printed", "colour": "rayleigh_rice", "acquisition": "off",
    "index": "usual",
}  # fmt: skip


def two_scale(theta_h, theta_d, phi_d, wavelength_um, **rest):
    """The BRDF of HP17 Eq. 24-33 at half and difference angles: effects, as `CHOICES` has them else, and parameters.

    Of the mirror term and of the diffracted light the apparatus leaves a share each, of the body everything.
    Under the conserving split lobes are not blurred, and the surface's albedo is an integral by fixed rules, to 1e-6.
    """
    with mp.workdps(DIGITS):
        at = _geometry(*(mp.mpf(x) for x in (theta_h, theta_d, phi_d)))
        wavelength_um = mp.mpf(wavelength_um)
        e = SimpleNamespace(**{name: rest.pop(name, choice) for name, choice in CHOICES.items()})
        v = SimpleNamespace(**{name: mp.mpf(x) for name, x in rest.items()})
        conducts = e.body == "none" if e.index == "usual" else e.index == "complex"
        v.index = (v.n, v.k) if conducts else (v.eta, mp.mpf(0))
        if min(at.cos_i, at.cos_o) <= 0:
            return mp.mpf(0)
        surface, body = lobes(at, wavelength_um, v, e, losses=_losses(at, v, e)), under(at, v, e)
        if e.split == "conserving":
            surface, body = conserved(surface, body, at, wavelength_um, v, e)
        return surface + body


def _geometry(theta_h, theta_d, phi_d):
    even, odd = mp.cos(theta_h) * mp.cos(theta_d), mp.sin(theta_h) * mp.sin(theta_d) * mp.cos(phi_d)
    return Geometry(theta_h, theta_d, phi_d, even - odd, even + odd)


def _losses(at, v, e):
    """What the apparatus leaves at grazing angles: of the mirror term, and of the diffracted light.

    ``acquisition`` is a name or the exponent of both itself.
    """
    if e.acquisition == "off":
        return mp.mpf(1), mp.mpf(1)
    diffracts = e.diffraction != "off"
    if e.acquisition == "free":
        exponents = v.grazing_exponent, v.grazing_exponent_diffracted if diffracts else 0
    elif e.acquisition == "derived":
        wider = derived_exponent_diffracted(v.beta, v.p, v.b, v.c) if diffracts else 0
        exponents = derived_exponent(v.beta, v.p), wider
    else:
        exponents = e.acquisition, e.acquisition
    return tuple(grazing(at.cos_i, at.cos_o, k) for k in exponents)
