"""The apparatus that a derived grazing loss assumes. Settings are read from here, so it does without jax."""

import math
from dataclasses import astuple, dataclass
from typing import Literal

GrazingLoss = Literal["off", "free", "derived"]


@dataclass(frozen=True)
class Apparatus:
    """A sphere photographed under a lamp; hashable, static under jit.

    How large the spheres of MERL are in their pictures is not part of the published data: the defaults are assumptions.

    Attributes:
        sphere_radius_px: radius of the sphere's image.
        pixel_sigma_px: standard deviation of a pixel's response, with the blur of lens and colour filters.
        lamp_sigma_rad: standard deviation of the lamp's direction, seen from the sphere. 0: a point.
        camera_nearness: the sphere's radius over the camera's distance from its centre. lamp_nearness: its radius over
            the lamp's distance from the surface. 0: far away.
    """

    sphere_radius_px: float = 200.0
    pixel_sigma_px: float = 1.0
    lamp_sigma_rad: float = 0.0
    camera_nearness: float = 0.0
    lamp_nearness: float = 0.0

    @property
    def footprint_rad(self) -> float:
        """Width w of the footprint at normal incidence: an arc of the sphere, so an angle of its normal (rad)."""
        return self.pixel_sigma_px / self.sphere_radius_px

    def __post_init__(self) -> None:
        """Refuse lengths that are no lengths, and a camera inside the sphere."""
        if not all(math.isfinite(x) for x in astuple(self)):
            raise ValueError(f"{self}: all lengths and angles must be finite")
        if not (self.sphere_radius_px > 0 and self.pixel_sigma_px > 0 and self.lamp_sigma_rad >= 0):
            raise ValueError(f"{self}: radius and pixel must be positive, the lamp's spread not negative")
        if not (0 <= self.camera_nearness < 1 and self.lamp_nearness >= 0):
            raise ValueError(f"{self}: the camera must be outside the sphere, the lamp above its surface")


APPARATUS = Apparatus()
