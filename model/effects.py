"""Which physical effects a material simulates: one frozen, hashable value, static under jit."""

from dataclasses import dataclass, fields
from typing import Literal, get_args, get_origin

Fresnel = Literal["exact", "schlick"]
Masking = Literal["smith", "height_correlated", "none"]
Diffraction = Literal["off", "lobe", "quadrature"]
Colour = Literal["rayleigh_rice", "fresnel"]
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
        fresnel: of the mirror term: ``exact`` (HP17 Eq. 3-4), or Schlick's polynomial.
        masking: ``smith`` (masking and shadowing independent, HP15 Eq. 6), ``height_correlated`` (Smith's joint form,
            Heitz 2014), ``none`` (1).
        renormalised: sigma_rel for sigma_s and the lobe's amplitude over the directions that exist (HP17 Eq. 17-19).
        colour: of the diffraction lobe: ``rayleigh_rice`` (Q/2, HP17 Eq. 10) or ``fresnel`` (F at theta_d, by the
            formula chosen for the mirror term).
    """

    body: Body = "none"
    diffraction: Diffraction = "quadrature"
    order: int = 32
    fresnel: Fresnel = "exact"
    masking: Masking = "smith"
    renormalised: bool = True
    colour: Colour = "rayleigh_rice"

    def __post_init__(self) -> None:
        """Refuse names that are not effects."""
        for field in fields(self):
            value, choices = getattr(self, field.name), get_args(field.type)
            if get_origin(field.type) is Literal and value not in choices:
                raise ValueError(f"{field.name} {value!r} is none of {', '.join(choices)}")
        if not 6 <= self.order <= 256:
            raise ValueError(f"order {self.order} of the convolution is outside 6..256")
