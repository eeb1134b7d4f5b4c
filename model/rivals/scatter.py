"""What models of optical scatter have in common: one lobe of the distance to the mirror direction, on the surface."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
from jax import Array

from ..body import lambert
from ..parameters import Parameter
from ..reflectance import OneFormula, Setting, Values
from .common import DIFFUSE


@dataclass(frozen=True)
class Scatter(OneFormula):
    """A lobe of x = |beta - beta0|, the distance of the projections of viewer and mirror direction on the surface.

    x = 2 cos_d sin theta_h, a vector's length, for any azimuth. Subclasses, a file each, say what the lobe is.

    Attributes:
        diffuse: ``none``, or a ``lambert`` body below it.
    """

    diffuse: Literal["none", "lambert"] = "none"

    @property
    @abstractmethod
    def scatter(self) -> tuple[Parameter, ...]:
        """Parameters of the lobe, the one per channel last."""

    @abstractmethod
    def lobe(self, x: Array, v: Values, s: Setting) -> Array:
        """The BRDF (1/sr) at a distance x."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (*self.scatter, *((DIFFUSE,) if self.diffuse == "lambert" else ()))

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return self.lobe(2 * s.geometry.cos_d * jnp.sin(s.geometry.theta_h), v, s)

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return lambert(v["diffuse_albedo"]) if self.diffuse == "lambert" else jnp.zeros(())
