"""Light that gratings of one period diffract, whatever way they are turned: flakes of prismatic (holographic) paints.

A grating of period d sends light of wavelength lambda to where the tangential part of i + o is m lambda / d, so that
flakes turned every way make a ring about the mirror direction for every order m:

    2 sin(theta_h) cos(theta_d) / lambda = m / d.

Its radius in spatial frequency is the same for all wavelengths and incidences, as that of any surface's power spectrum
(HP17 Eq. 14): a ring of colours is what a spectrum with a peak looks like. The light of a ring, the integral of
rho cos(theta_o), is lambda^2 times the integral of rho over the frequencies.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..acquisition import RINGS_RAD
from ..body import lambert
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import OneFormula, Profile, Setting, Values
from .common import DIFFUSE

ORDERS = 3  # rings; of a period below 0.89 um no other one is above the horizon in visible light


@dataclass(frozen=True)
class Grating(OneFormula):
    """Rings of Gaussian profile in spatial frequency, whose light falls by a factor from order to order.

        rho = sum_m E q^(m-1) / (1 + q + q^2) g((f - m/d) / (m s/d)) / (lambda^2 2 pi (m/d)^2 s) + rho_d / pi,
        f = 2 sin(theta_h) cos(theta_d) / lambda,    g the density of a standard normal.

    The relative width s is that of the periods, of the flakes' tilt and of the channel's band together; it is at most
    0.25, so that the first two rings stand apart. E is the light of all rings, whether they are above the horizon or
    not; in a sum only its product with the surface's share is known. Reciprocal; there is no masking.

    Accuracy: 1e-9 against an independent oracle (``tests/rivals/test_grating.py``).
    """

    name: ClassVar[str] = "grating"
    citation: ClassVar[str] = "Stam 1999, Diffraction shaders, doi:10.1145/311535.311546 (grating equation; rings here)"

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (
            Parameter("period", "d", "period of the gratings", "um", 0.8, 0.3, 3.0, source="grating equation",
                      prior=LogNormal(0.9, 1.5)),
            Parameter("spread", "s", "relative width of a ring", "1", 0.12, 0.02, 0.25, source="relative spread",
                      prior=LogNormal(0.12, 1.4)),
            Parameter("higher", "q", "light of a ring over that of the one before it", "1", 0.1, 0.0, 0.9, "linear",
                      source="geometric fall"),
            Parameter("efficiency", "E", "share of the light that the gratings diffract", "1", 0.5, 0.0, 1.0, "linear",
                      per_channel=True, source="diffraction efficiency", quantity="odds"),
            DIFFUSE,
        )  # fmt: skip

    @property
    def lobes(self) -> Mapping[str, Profile]:
        """A ring's profile across, about theta_h = 0: what is blurred away of a ring is as of a lobe of its width."""

        def across(v: Values, middle_um: Array) -> Array:
            turns = 2 * jnp.sin(jnp.asarray(RINGS_RAD)) / middle_um * v["period"]
            return jnp.exp(-((turns / v["spread"]) ** 2) / 2)

        return {"specular": across}

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        g = s.geometry
        rings = jnp.zeros(())
        turns = 2 * jnp.sin(g.theta_h) * g.cos_d / s.wavelength_um * v["period"]  # f d
        for m in range(1, ORDERS + 1):
            profile = jnp.exp(-(((turns / m - 1) / v["spread"]) ** 2) / 2) / jnp.sqrt(2 * jnp.pi)
            rings = rings + v["higher"] ** (m - 1) * profile / m**2
        light = v["efficiency"] / ((1 + v["higher"] + v["higher"] ** 2) * 2 * jnp.pi * v["spread"])
        return light * (v["period"] / s.wavelength_um) ** 2 * rings

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return lambert(v["diffuse_albedo"])
