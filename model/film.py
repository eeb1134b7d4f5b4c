"""Reflectance of an interface under a thin film, whose colour changes with the angle (Belcour & Barla 2017).

Light that goes back and forth in the film interferes with what the film's surface reflects (Airy's sum, their Eq. 2-3):

    r = (r_12 + r_23 e^(i phi)) / (1 + r_12 r_23 e^(i phi)),    phi = 2 pi OPD / lambda,  OPD = 2 eta d cos theta_f,

for either polarisation, r_12 and r_23 being the amplitudes of the film's two interfaces. A channel sees the mean of
|r|^2 over its band. Belcour & Barla sum the Fourier series of |r|^2; here the band is sampled, which keeps the mean
within [0, 1] at grazing angles, too, where the series hardly converges.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .fresnel import refracted_cosine
from .numerics import Real, safe_divide
from .parameters import WAVELENGTHS_UM

NODES, STEP = 15, 0.4  # of a band, and standard deviations between two of them
AT_ONCE = 5  # of a loop over nodes: all 15 written out would make a program with derivatives twice as large
FWHM = 2 * math.sqrt(2 * math.log(2))  # of a Gaussian, in standard deviations
_AT = STEP * (np.arange(NODES) - NODES // 2)
WEIGHTS = tuple((np.exp(-(_AT**2) / 2) / np.exp(-(_AT**2) / 2).sum()).tolist())  # of the nodes
SAME = 1e-3  # relative distance of wavelengths


def between_nodes(wavelength_um: Real) -> Real:
    """Wavenumbers (1/um) from one node of each channel's band to the next, (C, ...); 0 for a line.

    Red, green and blue have one wavelength each that stands for a band (``WAVELENGTHS_UM``). Nothing says how wide it
    is; so the bands are taken as lying side by side, Gaussians in the wavenumber that are as wide at half maximum as
    they are apart, 100 nm about. Any other wavelength is that of a laser or a spectrometer: a line.
    """
    wavelength_um = jnp.asarray(wavelength_um)
    if wavelength_um.shape[0] != len(WAVELENGTHS_UM):
        return jnp.zeros_like(wavelength_um)
    standing = np.array(WAVELENGTHS_UM).reshape((-1,) + (1,) * (wavelength_um.ndim - 1))
    apart = np.abs(np.gradient(1 / standing, axis=0)) * STEP / FWHM
    of_colours = jnp.all(jnp.abs(wavelength_um / standing - 1) < SAME)
    return jnp.where(of_colours, jnp.asarray(apart, wavelength_um.dtype), 0.0)


def reflectance(cos_theta: Real, n: Real, k: Real, eta: Real, thickness_um: Real, wavelength_um: Real) -> Real:
    """Unpolarised reflectance in [0, 1] of a film of index ``eta`` over matter of index ``n + i k``, (C, ...).

    It is that of the matter alone for a film of the outside's index 1, whatever its thickness.

    Args:
        cos_theta: cosine of the angle of incidence, outside. n, k: of the matter, (C, ...). eta: real, at least 1.
        thickness_um: of the film. wavelength_um: of the channels, (C, ...).

    Accuracy: 1e-12 at a wavelength alone. Over the bands of three colours, up to 70 degrees, 3e-3 where eta times the
    thickness is at most 1.3 um, and 3e-2 up to 3 um; beyond, 1.5e-2 and 4e-2 (``tests/model/test_film.py``).
    """
    sin2 = (1 - cos_theta) * (1 + cos_theta)
    cos_f = jnp.sqrt((eta**2 - sin2) / eta**2)
    inside = eta * cos_f
    c_real, c_imag = refracted_cosine(cos_theta, n, k)
    e_real, e_imag = (n - k) * (n + k), 2 * n * k
    s = (cos_theta - inside) / (cos_theta + inside)
    p = (eta * cos_theta - cos_f) / (eta * cos_theta + cos_f)
    below_s = _amplitude((inside, c_real), (jnp.zeros_like(c_imag), c_imag))
    below_p = _amplitude((e_real * cos_f, eta * c_real), (e_imag * cos_f, eta * c_imag))

    turn, step = 4 * jnp.pi * inside * thickness_um, between_nodes(wavelength_um)
    first = turn * (1 / wavelength_um - (NODES // 2) * step)
    phase, by = (jnp.cos(first), jnp.sin(first)), (jnp.cos(turn * step), jnp.sin(turn * step))

    def add(so_far: tuple[Array, Complex], weight: Array) -> tuple[tuple[Array, Complex], None]:
        """Nodes are evenly spaced: from one to the next the phase turns by the same angle."""
        total, phase = so_far
        seen = (_reflected(s, below_s, phase) + _reflected(p, below_p, phase)) / 2
        return (total + weight * seen, _product(phase, by)), None

    shape = jnp.broadcast_shapes(first.shape, below_s[0].shape)
    none = jnp.zeros(shape, first.dtype)
    begun = none, (jnp.broadcast_to(phase[0], shape), jnp.broadcast_to(phase[1], shape))
    return jax.lax.scan(add, begun, jnp.asarray(WEIGHTS, first.dtype), unroll=AT_ONCE)[0][0]


Complex = tuple[Array, Array]


def _product(x: Complex, y: Complex) -> Complex:
    return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]


def _amplitude(real: Complex, imag: Complex) -> Complex:
    """(a - b) / (a + b) of two complex numbers, from their real and their imaginary parts."""
    (a, b), (a_imag, b_imag) = real, imag
    below = (a + b) ** 2 + (a_imag + b_imag) ** 2
    return (
        safe_divide((a - b) * (a + b) + (a_imag - b_imag) * (a_imag + b_imag), below),
        safe_divide((a_imag - b_imag) * (a + b) - (a - b) * (a_imag + b_imag), below),
    )


def _reflected(outer: Array, inner: Complex, phase: Complex) -> Array:
    """|r_12 + r_23 e^(i phi)|^2 / |1 + r_12 r_23 e^(i phi)|^2."""
    real, imag = _product(inner, phase)
    return safe_divide((outer + real) ** 2 + imag**2, (1 + outer * real) ** 2 + (outer * imag) ** 2)
