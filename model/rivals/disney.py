"""Disney's principled model of 2012 (Burley, course notes, doi:10.1145/2343483.2343493), isotropic."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import jax.numpy as jnp
from jax import Array
from jax.lax import stop_gradient

from ..ndf import ggx, gtr
from ..numerics import Real, safe_divide
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import Factor, Lobes, Profile, Reflectance, Setting, Values
from .common import COAT_LOBE, LOST_OF_COAT, mix

COAT_F0, COAT_ALPHA, COAT_SHARE = 0.04, 0.25, 0.25  # an index of 1.5; its masking; of a clearcoat of 1
BRIGHTEST = 0.08  # reflectance at normal incidence of a specular of 1
LUMINANCE = (0.3, 0.6, 0.1)  # of linear red, green and blue, as BRDF Explorer's disney.brdf has it
SOURCE = "Burley 2012"


def _weight(name: str, symbol: str, meaning: str, odds: float) -> Parameter:
    """What may be 0 and mostly is: what the data do not decide stays near there."""
    return Parameter(name, symbol, meaning, "1", 0.1, 0.0, 1.0, "linear", source=SOURCE, quantity="odds",
                     prior=LogNormal(odds, 6.0))  # fmt: skip


PARAMETERS = (
    Parameter("roughness", "r", "square root of the width alpha of the facets' GGX distribution", "1", 0.3, 0.032, 1.0,
              source=SOURCE, prior=LogNormal(0.3, 2.0)),
    Parameter("specular", "s", "reflectance of a dielectric at normal incidence, over 0.08", "1", 0.5, 0.0, 1.0,
              "linear", source=SOURCE),
    _weight("specularTint", "t_s", "how much the base colour tints the dielectric's reflection", 0.05),
    _weight("metallic", "m", "weight of the metal, against that of the dielectric", 0.02),
    _weight("sheen", "h", "weight of the sheen of cloth at grazing angles", 0.05),
    _weight("sheenTint", "t_h", "how much the base colour tints the sheen", 1.0),
    _weight("clearcoat", "c", "weight of the clear coat", 0.05),
    Parameter("clearcoatGloss", "g_c", "gloss of the clear coat, whose width alpha falls from 0.1 to 0.001", "1", 0.5,
              0.0, 1.0, "linear", source=SOURCE),
    _weight("subsurface", "u", "how much the body is that of light scattered below the surface", 0.05),
    Parameter("baseColor", "C", "colour of the body and of a metal", "1", 0.3, 0.0, 1.0, "linear", per_channel=True,
              source=SOURCE, quantity="odds"),
)  # fmt: skip


@dataclass(frozen=True)
class Disney(Reflectance):
    """With F = (1 - cos_d)^5, L and V the same of cos_i and cos_o, and mix(a, b, t) = a + t (b - a):

        rho = GGX(theta_h; r^2) G mix(C_s, 1, F) / (4 cos_i cos_o)                                             facets
            + c/4 GTR1(theta_h; mix(0.1, 0.001, g_c)) G(0.25) mix(0.04, 1, F) / (4 cos_i cos_o)             clearcoat
            + (1 - m) (C/pi mix(f_d, f_ss, u) + h F mix(1, C/Y, t_h))                                            body
        C_s = mix(0.08 s mix(1, C/Y, t_s), C, m),   Y = 0.3 R + 0.6 G + 0.1 B of C
        f_d = mix(1, D, L) mix(1, D, V), D = 0.5 + 2 r cos_d^2
        f_ss = 1.25 (mix(1, S, L) mix(1, S, V) (1/(cos_i + cos_o) - 1/2) + 1/2), S = r cos_d^2 (Burley 2015)

    G is Smith's of light times that of the viewer. Anisotropy is left out. Y is the mean where there are no three
    channels; derivatives go without that of Y, which takes effect through specularTint and sheenTint alone and so has
    the same stationary points where both are free and neither is at 1. Reciprocal; not energy-preserving.

    Accuracy: 1e-10 against an independent oracle (``tests/rivals/test_principled.py``).

    Attributes:
        masking: ``smith``, G's width is r^2, as renderers have it today; ``remapped``, (0.5 + r/2)^2, of the notes.
    """

    name: ClassVar[str] = "disney"
    citation: ClassVar[str] = (
        "Burley 2012, Physically-based shading at Disney, SIGGRAPH course notes, doi:10.1145/2343483.2343493; "
        "subsurface as in Burley 2015, Extending the Disney BRDF to a BSDF, doi:10.1145/2776880.2787670"
    )
    masking: Literal["smith", "remapped"] = "smith"

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return PARAMETERS

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102
        return {"specular": None, COAT_LOBE: None}

    passed_over = Reflectance.passed_over | LOST_OF_COAT

    def factors(self) -> Mapping[str, Factor]:  # noqa: D102
        return {
            "facets": _facets,
            "distribution": lambda v, s: ggx.D(s.geometry.theta_h, v["roughness"] ** 2),
            "masked": self._masked,
            "coat": _coat,
            "body": _body,
        }

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        return Lobes(
            {"specular": at["facets"] * at["distribution"] * at["masked"], COAT_LOBE: at["coat"]}, body=at["body"]
        )

    def _masked(self, v: Values, s: Setting) -> Array:
        r = v["roughness"]
        return _smith(s, r**2 if self.masking == "smith" else (0.5 + r / 2) ** 2)


def _smith(s: Setting, alpha: Real | float) -> Array:
    """G1(i) G1(o) / (4 cos_i cos_o)."""
    one, other = (
        ggx.G1(cos, jnp.asarray(alpha, cos.dtype)) / (2 * cos) for cos in (s.geometry.cos_i, s.geometry.cos_o)
    )
    return one * other


def _grazing(cos: Array) -> Array:
    return (1 - cos) ** 5


def _tinted(base: Array, share: Array) -> Array:
    """mix(1, C/Y, share); 1 where the base is black."""
    weights = jnp.asarray(LUMINANCE, base.dtype) if len(base) == len(LUMINANCE) else jnp.full(len(base), 1 / len(base))
    Y = stop_gradient(jnp.tensordot(weights.astype(base.dtype), base, 1))
    return mix(1.0, jnp.where(Y > 0, safe_divide(base, Y), 1.0), share)


def _facets(v: Values, s: Setting) -> Array:
    base = v["baseColor"]
    normal = mix(BRIGHTEST * v["specular"] * _tinted(base, v["specularTint"]), base, v["metallic"])
    return mix(normal, 1.0, _grazing(s.geometry.cos_d))


def _coat(v: Values, s: Setting) -> Array:
    g = s.geometry
    D = gtr.D(g.theta_h, mix(0.1, 0.001, v["clearcoatGloss"]), 1.0)
    F = mix(COAT_F0, 1.0, _grazing(g.cos_d))
    return COAT_SHARE * v["clearcoat"] * D * F * _smith(s, COAT_ALPHA)


def _body(v: Values, s: Setting) -> Array:
    g, base, rough = s.geometry, v["baseColor"], v["roughness"] * s.geometry.cos_d**2
    light, viewer = _grazing(g.cos_i), _grazing(g.cos_o)
    diffuse = mix(1.0, 0.5 + 2 * rough, light) * mix(1.0, 0.5 + 2 * rough, viewer)
    below = mix(1.0, rough, light) * mix(1.0, rough, viewer)
    below = 1.25 * (below * (1 / (g.cos_i + g.cos_o) - 0.5) + 0.5)
    sheen = v["sheen"] * _grazing(g.cos_d) * _tinted(base, v["sheenTint"])
    return (1 - v["metallic"]) * (base / jnp.pi * mix(diffuse, below, v["subsurface"]) + sheen)
