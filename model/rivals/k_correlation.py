"""Scatter of a smooth surface by Rayleigh & Rice, whose power spectrum is a K-correlation."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..numerics import expm1_over
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import Setting, Values
from .scatter import Scatter
from .smooth import lobe

SOURCE = "Dittman 2006"


@dataclass(frozen=True)
class KCorrelation(Scatter):
    """4 pi^2 2^2 / lambda^4 cos_i cos_o PSD(x / lambda) of a perfect mirror with a roughness per channel.

    PSD(f) = sigma^2 (s - 2) B^2 / (2 pi (1 - (1 + (B/lambda)^2)^(1 - s/2))) (1 + (B f)^2)^(-s/2), finite at s = 2. A
    sigma that is the same in all channels is a surface without colour; the reflectance of one that is none is in it.

    Accuracy: 1e-10 against an independent oracle (``tests/rivals/test_peers.py``).
    """

    name: ClassVar[str] = "k-correlation"
    citation: ClassVar[str] = (
        "Dittman 2006, K-correlation power spectral density and surface scatter model, doi:10.1117/12.678320"
    )

    @property
    def scatter(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Scatter`, like what follows
        return (
            Parameter("B", "B", "correlation length of the surface, times 2 pi", "um", 10.0, 0.1, 1e5, source=SOURCE,
                      prior=LogNormal(10.0, 6.0)),
            Parameter("s", "s", "falloff exponent of the power spectrum", "1", 2.5, 0.1, 20.0, source=SOURCE,
                      prior=LogNormal(2.0, 1.8)),
            Parameter("sigma", r"\sigma", "root mean square roughness that scatters", "um", 0.02, 1e-6, 10.0,
                      per_channel=True, source=SOURCE, prior=LogNormal(0.02, 6.0)),
        )  # fmt: skip

    def lobe(self, x: Array, v: Values, s: Setting) -> Array:  # noqa: D102
        wavelength, half = s.wavelength_um, v["s"] / 2
        B = v["B"] / wavelength
        ends = jnp.log1p(B**2)
        # (s - 2) / (1 - exp(-u)), u = (s/2 - 1) ends
        share = 2 / (ends * expm1_over((1 - half) * ends))
        height = 16 * jnp.pi**2 * (v["sigma"] * B / wavelength) ** 2 * share / (2 * jnp.pi)
        return height * s.geometry.cos_i * s.geometry.cos_o * lobe(x**2, B**2, half)
