"""Reflectance of an interface under a thin film, whose colour changes with the angle (Belcour & Barla 2017).

Light that goes back and forth in the film interferes with what the film's surface reflects (Airy's sum, their Eq. 2-3):

    r = (r_12 + r_23 e^(i phi)) / (1 + r_12 r_23 e^(i phi)),    phi = 2 pi OPD / lambda,  OPD = 2 eta d cos theta_f,

for either polarisation, r_12 and r_23 being the amplitudes of the film's two interfaces. A channel sees the mean of
|r|^2 over its band. Belcour & Barla sum the Fourier series of |r|^2; here the band is sampled, which keeps the mean
within [0, 1] at grazing angles, too, where the series hardly converges.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .fresnel import refracted_cosine
from .numerics import Real, safe_divide

NODES, STEP = 15, 0.4  # of a band, and standard deviations between two of them
FWHM = 2 * math.sqrt(2 * math.log(2))  # of a Gaussian, in standard deviations


class Band(NamedTuple):
    """Wavenumbers (1/um) of a channel's band, (NODES, C, ...), and their weights (NODES, 1, ...), which sum to 1."""

    wavenumbers: Real
    weights: Real


def band_of(wavelength_um: Real) -> Band:
    """Bands of channels that lie side by side: Gaussians in the wavenumber, as wide at half maximum as they are apart.

    Three wavelengths of a camera have bands of 100 nm about, 31 of a spectrometer 10 nm; one alone is a line.

    Args:
        wavelength_um: of the channels, (C, ...).
    """
    centre = 1 / jnp.asarray(wavelength_um)
    apart = jnp.zeros_like(centre)
    if centre.shape[0] > 1:
        ranked = jnp.sort(centre, 0)
        gaps = jnp.diff(ranked, axis=0)
        each = (jnp.concatenate([gaps[:1], gaps]) + jnp.concatenate([gaps, gaps[-1:]])) / 2
        apart = jnp.take_along_axis(each, jnp.argsort(jnp.argsort(centre, 0), 0), 0)
    at = STEP * (np.arange(NODES) - NODES // 2)
    weights = np.exp(-(at**2) / 2)
    shape = (NODES,) + (1,) * centre.ndim
    sampled = centre + jnp.asarray(at, centre.dtype).reshape(shape) * apart / FWHM
    return Band(sampled, jnp.asarray(weights / weights.sum(), centre.dtype).reshape(shape))


def reflectance(cos_theta: Real, n: Real, k: Real, eta: Real, thickness_um: Real, wavelength_um: Real) -> Real:
    """Unpolarised reflectance in [0, 1] of a film of index ``eta`` over matter of index ``n + i k``, (C, ...).

    It is that of the matter alone for a film of the outside's index 1, whatever its thickness.

    Args:
        cos_theta: cosine of the angle of incidence, outside. n, k: of the matter, (C, ...). eta: real, at least 1.
        thickness_um: of the film. wavelength_um: of the channels, (C, ...).
    """
    sin2 = (1 - cos_theta) * (1 + cos_theta)
    cos_f = jnp.sqrt((eta**2 - sin2) / eta**2)
    inside = eta * cos_f
    c_real, c_imag = refracted_cosine(cos_theta, n, k)
    e_real, e_imag = (n - k) * (n + k), 2 * n * k
    band = band_of(wavelength_um)
    phase = 2 * jnp.pi * (2 * inside * thickness_um) * band.wavenumbers
    cos_phase, sin_phase = jnp.cos(phase), jnp.sin(phase)

    def reflected(outer: Real, real: tuple[Real, Real], imag: tuple[Real, Real]) -> Real:
        """The mean of |r_12 + r_23 e^(i phi)|^2 / |1 + r_12 r_23 e^(i phi)|^2, with r_23 = (a - b) / (a + b)."""
        (a, b), (a_imag, b_imag) = real, imag
        below = (a + b) ** 2 + (a_imag + b_imag) ** 2
        inner_real = safe_divide((a - b) * (a + b) + (a_imag - b_imag) * (a_imag + b_imag), below)
        inner_imag = safe_divide((a_imag - b_imag) * (a + b) - (a - b) * (a_imag + b_imag), below)
        turned_real = inner_real * cos_phase - inner_imag * sin_phase
        turned_imag = inner_real * sin_phase + inner_imag * cos_phase
        above = (outer + turned_real) ** 2 + turned_imag**2
        around = (1 + outer * turned_real) ** 2 + (outer * turned_imag) ** 2
        return jnp.sum(band.weights * safe_divide(above, around), 0)

    s = (cos_theta - inside) / (cos_theta + inside)
    p = (eta * cos_theta - cos_f) / (eta * cos_theta + cos_f)
    reflected_s = reflected(s, (inside, c_real), (jnp.zeros_like(c_imag), c_imag))
    reflected_p = reflected(p, (e_real * cos_f, eta * c_real), (e_imag * cos_f, eta * c_imag))
    return (reflected_s + reflected_p) / 2
