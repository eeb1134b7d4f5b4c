"""Which physical effects a material simulates: one frozen, hashable value, static under jit."""

from dataclasses import dataclass
from typing import Literal, get_args

Diffraction = Literal["off", "lobe", "quadrature"]
Body = Literal["none", "lambert", "plastic", "subsurface"]
BODIES: tuple[Body, ...] = get_args(Body)
DIFFRACTIONS: tuple[Diffraction, ...] = get_args(Diffraction)


@dataclass(frozen=True)
class Effects:
    """The effects of one two-scale material; what is not chosen is absent from the compiled program.

    Attributes:
        body: ``none`` is a conductor (complex index per channel); the others are dielectrics (real index per channel)
            over a body with an albedo per channel.
        diffraction: ``off``; ``lobe`` (microfacet normals taken as all alike in the diffraction lobe); ``quadrature``
            (the lobe blurred by the normals, HP17 Eq. 33).
        order: radial nodes of ``quadrature``; accuracy in :func:`merlfit.model.convolution.convolve`.
    """

    body: Body = "none"
    diffraction: Diffraction = "quadrature"
    order: int = 32

    def __post_init__(self) -> None:
        """Refuse names that are not effects."""
        if self.body not in BODIES:
            raise ValueError(f"body {self.body!r} is none of {', '.join(BODIES)}")
        if self.diffraction not in DIFFRACTIONS:
            raise ValueError(f"diffraction {self.diffraction!r} is none of {', '.join(DIFFRACTIONS)}")
        if not 6 <= self.order <= 256:
            raise ValueError(f"order {self.order} of the convolution is outside 6..256")
