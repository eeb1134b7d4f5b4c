"""Which effects the two-scale model simulates: choices, defaults, presets. Settings are read from here: no jax.

:class:`merlfit.model.two_scale.TwoScale` is the model with its effects.
"""

from dataclasses import dataclass, fields
from typing import Any, Literal, TypeVar, get_args, get_origin

TWO_SCALE = "two-scale"  # the model's name
LEAST_ORDER = 6  # of a quadrature
BODIES = ("none", "lambert", "plastic", "subsurface")
ANY = "any"  # of `TwoScale.general` alone, of no material
Fresnel = Literal["exact", "schlick"]
Masking = Literal["smith", "height_correlated", "none"]
Diffraction = Literal["off", "lobe", "quadrature", "exact"]
Split = Literal["printed", "conserving", "free"]
Colour = Literal["rayleigh_rice", "fresnel"]
Index = Literal["usual", "complex", "real", "film"]
Body = Literal["none", "lambert", "plastic", "subsurface", "any"]
Kind = tuple[Index, Body]
Same = TypeVar("Same", bound="Effects")
KINDS: tuple[Kind, ...] = (
    ("complex", "none"), ("real", "lambert"), ("real", "plastic"), ("real", "subsurface"), ("complex", "lambert"),
)  # fmt: skip
"""Interfaces and bodies that a fit compares, the simplest first: by the number of parameters, then of effects."""
FILMS: tuple[Kind, ...] = (("film", "none"), ("film", "lambert"))
"""Those with a film, which are compared where one is asked for."""


@dataclass(frozen=True)
class Effects:
    """The effects that a two-scale material has; what is not chosen is absent from the compiled program.

    An option that nothing chosen uses is refused unless it is the default, so that equal programs are equal values and
    compile once; :meth:`changed` heeds that.

    Attributes:
        body: what lies under the interface, with an albedo per channel, or ``none``.
        diffraction: how the facets' diffraction lobe is blurred by the distribution of their normals, cheapest first:
            ``off``; ``lobe`` (normals taken as all alike); ``quadrature`` (Eq. 33); ``exact`` (Eq. 27, the reference:
            milliseconds a direction).
        order: radial nodes of ``quadrature``; accuracy in :func:`merlfit.model.convolution.convolve`.
        fresnel: of the specular term: ``exact`` (HP17 Eq. 3-4), or Schlick's polynomial.
        masking: ``smith`` (masking and shadowing independent, HP15 Eq. 6), ``height_correlated`` (Smith's joint form,
            Heitz 2014), ``none`` (1).
        renormalised: sigma_rel for sigma_s and the lobe's amplitude over the directions that exist (HP17 Eq. 17-19).
        split: of the energy, between specular term, diffraction lobe and what lies below: ``printed`` (HP17 Eq. 25);
            ``conserving`` (:mod:`merlfit.model.energy`), which never reflects more than it receives; or ``free``: that
            of HP17 with a weight in [0, 1] per channel on the diffraction lobe, so that A_spec is no longer its share.
        colour: of the diffraction lobe: ``rayleigh_rice`` (Q/2, HP17 Eq. 10) or ``fresnel`` (F at theta_d, by the
            formula chosen for the specular term), which is a film's.
        index: of refraction of the interface, per channel: ``complex`` (n + i k, a conductor), ``real`` (a
            dielectric), ``film`` (a thin transparent film over a complex one, whose interference colours both lobes:
            :mod:`merlfit.model.film`), or ``usual``: complex over no body, real over one. A Lambert floor under a
            complex index is stray light and dust on a metal; plastic and subsurface ask how light gets through the
            interface, and so for a real one.
    """

    body: Body = "none"
    diffraction: Diffraction = "quadrature"
    order: int = 32
    fresnel: Fresnel = "exact"
    masking: Masking = "smith"
    renormalised: bool = True
    split: Split = "printed"
    colour: Colour = "rayleigh_rice"
    index: Index = "usual"

    def __post_init__(self) -> None:
        """Refuse names that are not effects, numbers out of range, and options that nothing uses."""
        for field in fields(self):
            value, choices = getattr(self, field.name), get_args(field.type)
            if get_origin(field.type) is Literal and value not in choices:
                raise ValueError(f"{field.name} {value!r} is none of {', '.join(choices)}")
            if field.type in (bool, int) and type(value) is not field.type:
                raise ValueError(f"{field.name} {value!r} is no {field.type.__name__}")
        if not LEAST_ORDER <= self.order <= 256:
            raise ValueError(f"order {self.order} of the convolution is outside 6..256")
        for name, where in idle(self.diffraction, self.split).items():
            if getattr(self, name) != getattr(type(self), name):
                raise ValueError(f"{name} has an effect only where {where}: leave it out")
        if self.index == "usual":
            object.__setattr__(self, "index", "complex" if self.body == "none" else "real")
        if self.index == "film":
            if self.fresnel != "exact":
                raise ValueError(f"fresnel {self.fresnel!r}, which preset 'preview' has, knows of no film")
            if self.diffraction != "off":
                object.__setattr__(self, "colour", "fresnel")
        if self.index in ("complex", "film") and self.body in ("plastic", "subsurface"):
            raise ValueError(f"body {self.body!r} lies under a clear interface: its index is real, not {self.index}")

    def changed(self: Same, **settings: Any) -> Same:  # noqa: ANN401 - of its fields
        """The same with other settings; options that nothing uses any more take their defaults, given here or not.

        ``index`` stays what it is: with another body, ``index="usual"`` gives that body's own.
        """
        wanted = {field.name: getattr(self, field.name) for field in fields(self)} | settings
        unused = idle(wanted["diffraction"], wanted["split"])
        return type(self)(**{name: value for name, value in wanted.items() if name not in unused})


def idle(diffraction: Diffraction, split: Split) -> dict[str, str]:
    """Options that a tier of diffraction does not use, and where they have an effect, in words."""
    used = {
        "order": (diffraction == "quadrature", "diffraction is quadrature"),
        "renormalised": (diffraction != "off", "diffraction is not off"),
        "colour": (diffraction != "off", "diffraction is not off"),
        "split": (diffraction != "off" or split != "free", "diffraction is not off"),
    }
    return {name: where for name, (heeded, where) in used.items() if not heeded}


PRESETS: dict[str, Effects] = {
    "hp17": Effects(),
    "conserving": Effects(split="conserving"),
    "free": Effects(split="free"),
    "microfacet": Effects(diffraction="off"),
    "preview": Effects(diffraction="lobe", fresnel="schlick", colour="fresnel", renormalised=False),
    "fast": Effects(diffraction="lobe"),
    "reference": Effects(diffraction="exact"),
}
"""Effects by name: HP17's model; the same conserving energy, or with weights of the diffracted light; Cook-Torrance
alone; the cheapest with diffraction, for looks; the lobe without blur, and all else as in HP17; Eq. 27 itself."""
