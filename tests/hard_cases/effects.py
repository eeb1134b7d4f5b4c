"""What the hard cases are about: the model's functions and their oracles of 30 digits, by the name of the effect."""

from dataclasses import fields

import jax.numpy as jnp
import mpmath as mp
from merlfit.model import acquisition, body, convolution, diffraction, energy, film, fresnel
from merlfit.model.geometry import Geometry
from merlfit.model.masking import smith
from merlfit.model.measured import Measured
from merlfit.model.ndf.epd import epd
from merlfit.model.two_scale import TwoScale, two_scale

from ..oracles import films, precise

FIELDS = tuple(x.name for x in fields(TwoScale))
CHOICES = (*FIELDS[: FIELDS.index("index")], "acquisition", *FIELDS[FIELDS.index("index") :])  # marks of cases go by it
TIERS = (
    "quadrature",
    "exact",
    "conserving",
)  # with accuracies of their own; and the free split and films, with their own oracles
DEAR = (
    "convolve", "convolve_256", "lobe_albedo", "two_scale", "two_scale_free", "two_scale_film",
    *(f"two_scale_{tier}" for tier in TIERS),
)  # fmt: skip


def specular_share(theta_d, wavelength_um, b, c, sigma_s):
    """A_spec as the assembled model has it."""
    share = diffraction.renormalisation(jnp.sin(theta_d), b / wavelength_um, c)
    return jnp.exp(-diffraction.phase_variance(share * sigma_s**2, jnp.cos(theta_d), wavelength_um))


def grazing(cos_i, cos_o, exponent):
    """The acquisition's loss of two directions."""
    still = jnp.zeros_like(cos_i)
    return jnp.exp(exponent * acquisition.grazing_log_base(Geometry(still, still, cos_i, cos_o)))


def facet_albedo(theta_d, wavelength_um, b, c, sigma_s, renormalised, exact):
    """The conserving split's lobe albedo at one wavelength, of the angle's dtype, as the assembled model makes it."""
    table = energy.lobe_albedo_table(b, c, sigma_s, wavelength_um[None], renormalised, exact)
    return energy.lobe_albedo(theta_d, table)[0].astype(theta_d.dtype)


def convolve(theta_h, B, c, beta, p, order):
    """The convolution by position: so its custom derivative rules bind."""
    return convolution.convolve(theta_h, B, c, beta, p, order)


def assembled(theta_h, theta_d, phi_d, wavelength_um, **rest):
    """The BRDF at one wavelength; ``rest`` are effects and parameters."""
    loss = rest.pop("acquisition", "off")
    model = Measured(TwoScale(**{name: rest.pop(name) for name in FIELDS if name in rest}), loss)
    geometry = Geometry.from_half_difference(theta_h, theta_d, phi_d)
    return two_scale(rest, geometry, model, wavelength_um[None])[0]


def convolved(order, **at):
    """The convolution itself, whatever the order it is to be had by."""
    return precise.convolve(**at)


def free_split(weight, **at):
    """The printed split's BRDF, and its terms without the diffracted light, A_spec of the mirror term and the body."""
    printed = {**at, "split": "printed"}
    undiffracted = {**printed, "diffraction": "off"}
    mirror = {**undiffracted, "body": "none", "index": "complex" if "n" in at else "real"}
    with mp.workdps(30):
        kept = precise.specular_share(*(mp.mpf(at[q]) for q in ("theta_d", "wavelength_um", "b", "c", "sigma_s")))
        without = precise.two_scale(**undiffracted) - (1 - kept) * precise.two_scale(**mirror)
        return weight * precise.two_scale(**printed) + (1 - weight) * without


def of_film(cos_theta, n, k, eta, thickness_um, wavelength_um):
    """The film's reflectance at one wavelength."""
    return film.reflectance(cos_theta, n[None], k[None], eta, thickness_um, wavelength_um[None])[0]


def filmed(film_eta, film_thickness, **at):
    """The BRDF of an interface of which both lobes have the colour F(theta_d), with a film's reflectance for F."""
    bare = {**at, "index": "complex", "colour": "fresnel"}
    with mp.workdps(30):
        lobes = precise.two_scale(**{**bare, "body": "none"})
        cosine = mp.cos(mp.mpf(at["theta_d"]))
        under = films.reflectance_of_line(cosine, at["n"], at["k"], film_eta, film_thickness, at["wavelength_um"])
        return precise.two_scale(**bare) + lobes * (under / precise.fresnel(cosine, at["n"], at["k"]) - 1)


# Stored references are marked by the oracle's name: renaming one makes them out of date.
PAIRS = {
    "fresnel": (fresnel.fresnel, precise.fresnel),
    "schlick": (fresnel.schlick, precise.schlick),
    "diffraction_colour": (fresnel.diffraction_colour, precise.diffraction_colour),
    "film": (of_film, films.reflectance_of_line),
    "epd": (epd, precise.epd),
    "smith_lambda": (smith.smith_lambda, precise.smith_lambda),
    "masking": (smith.masking_direct, precise.masking),
    "masking_table": (smith.masking, precise.masking),
    "renormalisation": (diffraction.renormalisation, precise.renormalisation),
    "lobe": (convolution.lobe, precise.lobe),
    "specular_share": (specular_share, precise.specular_share),
    "convolve": (convolve, convolved),
    "convolve_256": (convolve, convolved),
    "lobe_albedo": (facet_albedo, precise.lobe_albedo),
    "lambert": (body.lambert, precise.lambert),
    "plastic": (body.plastic, precise.plastic),
    "subsurface": (body.subsurface, precise.subsurface),
    "grazing": (grazing, precise.grazing),
    "two_scale_free": (assembled, free_split),
    "two_scale_film": (assembled, filmed),
    **dict.fromkeys(("two_scale", *(f"two_scale_{tier}" for tier in TIERS)), (assembled, precise.two_scale)),
}
MODEL = {effect: pair[0] for effect, pair in PAIRS.items()}
ORACLE = {effect: pair[1] for effect, pair in PAIRS.items()}
