"""Base and coat of OpenPBR 1.1 (Academy Software Foundation), what they reflect."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from .. import chebyshev
from ..body import energy_preserving_oren_nayar, internal_diffuse_reflectance
from ..fresnel import fresnel_of_dielectric, schlick_of_F0
from ..masking.smith import height_correlated
from ..ndf import ggx
from ..numerics import Real, Scalar, safe_sqrt
from ..parameters import Parameter
from ..priors import LogNormal
from ..quadrature import gauss_legendre
from ..reflectance import Factor, Lobes, Profile, Reflectance, Setting, Values
from .common import COAT_LOBE, LOST_OF_COAT, mix

EDGE = 1 / 7  # cosine of the angle, 82 degrees, at which specular_color tints a metal
NODES = 24  # cosines at which an albedo is integrated
CAP, TURNS = 20, 16  # Gauss nodes of visible facets
SOURCE = "OpenPBR 1.1"


def _share(name: str, symbol: str, meaning: str, odds: float, per_channel: bool = False) -> Parameter:
    """Of 0 to 1; what the data do not decide stays near the specification's default, which is the prior's median."""
    return Parameter(name, symbol, meaning, "1", odds / (1 + odds), 0.0, 1.0, "linear", per_channel=per_channel,
                     source=SOURCE, quantity="odds", prior=LogNormal(odds, 6.0))  # fmt: skip


def _rough(name: str, symbol: str, meaning: str, median: float) -> Parameter:
    return Parameter(name, symbol, meaning, "1", median, 0.032, 1.0, source=SOURCE, prior=LogNormal(median, 2.0))


def _index(name: str, symbol: str, meaning: str, default: float) -> Parameter:
    return Parameter(name, symbol, meaning, "1", default, 1.001, 3.0, offset=1.0, source=SOURCE,
                     prior=LogNormal(default - 1, 1.5))  # fmt: skip


PARAMETERS = (
    _rough("specular_roughness", "r", "square root of the width alpha of the base's GGX distribution", 0.3),
    _index("specular_ior", "n", "index of refraction of the dielectric base", 1.5),
    _share("base_metalness", "M", "weight of the metal, against that of the dielectric", 0.02),
    _share("base_diffuse_roughness", r"\sigma", "roughness of the diffuse base", 0.1),
    _share("coat_weight", "C", "share of the surface that has a coat", 0.05),
    _rough("coat_roughness", "r_C", "square root of the width alpha of the coat's GGX distribution", 0.15),
    _index("coat_ior", "n_C", "index of refraction of the coat", 1.6),
    _share("base_color", r"\rho", "colour of the diffuse base, and of a metal along the normal", 0.3, True),
    _share("specular_color", "s", "tint of the dielectric's reflection, and of a metal's at 82 degrees", 30.0, True),
    _share("coat_color", "c", "what a coat lets through along the normal, there and back", 30.0, True),
)  # fmt: skip


@dataclass(frozen=True)
class OpenPBR(Reflectance):
    """Glossy-diffuse and metal, mixed, under a coat, by the specification's own reduction to lobes.

        rho = C f_coat + W ((1 - M) (s f_gloss + (1 - E_gloss) f_diffuse) + M f_metal)
        W = mix(1, (1 - E_coat) c^((1/mu_i + 1/mu_o)/2), C) mix(1, (1 - K)/(1 - E_b K), C)

    f are GGX facets with height-correlated masking, f_diffuse the energy-preserving Oren-Nayar model of Portsmouth et
    al. 2025, E albedos of facets, mu refracted cosines. The coat's absorption and darkening, the roughness of the base
    under it and its index beside the coat's are those of "Coat". The specification's layers look at the viewer alone;
    this is the mean of the formula and of that with light and viewer exchanged: reciprocal. ``base_weight`` and
    ``specular_weight`` are 1, as only their products with ``base_color``, and nearly so with the base's reflectance,
    are seen; ``coat_darkening`` is 1. Left out: transmission, subsurface, fuzz, thin film, anisotropy, light of several
    bounces between facets (so that rough metals are dark).

    Accuracy: 1e-3 against an independent oracle with albedos by another rule (``tests/rivals/test_principled.py``).
    """

    name: ClassVar[str] = "openpbr"
    citation: ClassVar[str] = (
        "OpenPBR Surface specification 1.1, https://academysoftwarefoundation.github.io/OpenPBR; Portsmouth, Kutz & "
        "Hill 2025, EON: a practical energy-preserving rough diffuse BRDF, JCGT 14(1), doi:10.48550/arXiv.2410.18026"
    )
    passed_over = Reflectance.passed_over | LOST_OF_COAT

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return PARAMETERS

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102
        return {"specular": None, COAT_LOBE: None}

    def tables(self, scattered: bool = False) -> Mapping[str, Factor]:  # noqa: D102
        return {
            "albedo_of_gloss": lambda v, s: _gloss_table(v),
            "albedo_of_coat": lambda v, s: _coat_table(v),
            "turned_back": lambda v, s: internal_diffuse_reflectance(v["coat_ior"]),
        }

    def factors(self) -> Mapping[str, Factor]:  # noqa: D102
        return {
            "facets": _facets,
            "distribution": lambda v, s: ggx.D(s.geometry.theta_h, base_width(v)),
            "masked": lambda v, s: _correlated(s, base_width(v)),
            "coat": _coat,
            "diffuse": _diffuse,
            "through_i": lambda v, s: _through(v, s, s.geometry.cos_i),
            "through_o": lambda v, s: _through(v, s, s.geometry.cos_o),
            "left_i": lambda v, s: _left(v, s.geometry.cos_i),
            "left_o": lambda v, s: _left(v, s.geometry.cos_o),
        }

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        lobe = at["facets"] * at["distribution"] * at["masked"]
        through = (at["through_i"] + at["through_o"]) / 2
        to_diffuse = (at["through_i"] * at["left_i"] + at["through_o"] * at["left_o"]) / 2
        return Lobes({"specular": through * lobe, COAT_LOBE: at["coat"]}, body=to_diffuse * at["diffuse"])


def base_width(v: Values) -> Scalar:
    """Width alpha of the base's facets, those under a rough coat seen wider ("Roughening")."""
    own, coat = v["specular_roughness"] ** 4, v["coat_roughness"] ** 4
    return mix(v["specular_roughness"], jnp.minimum(1.0, own + 2 * coat) ** 0.25, v["coat_weight"]) ** 2


def base_ratio(v: Values) -> Scalar:
    """Index of the dielectric base over that around it; under a coat the larger over the smaller: none reflects all."""
    beside = v["specular_ior"] / v["coat_ior"]
    return mix(v["specular_ior"], jnp.maximum(beside, 1 / beside), v["coat_weight"])


def metal(cos: Real, F0: Real, tint: Real) -> Real:
    """Reflectance of a metal by F82-tint ("Metal")."""
    dip = (1 - tint) * schlick_of_F0(jnp.asarray(EDGE, cos.dtype), F0) / (EDGE * (1 - EDGE) ** 6)
    return schlick_of_F0(cos, F0) - cos * (1 - cos) ** 6 * dip


def albedo_table(alpha: Scalar, ratio: Scalar) -> Real:
    """Share of light that dielectric facets reflect, by the cosine of the viewer: coefficients of `chebyshev.series`.

    The mean of F G2/G1 over visible facets, drawn as spherical caps (Dupuy & Benyoub 2023). To 2.5e-3 of the light
    (``tests/rivals/test_principled.py``), beside the horizon, below 1 degree, of lobes narrower than that.
    """
    cos = jnp.asarray(chebyshev.nodes(NODES))[:, None, None]
    (u, cap), (turn, round_) = gauss_legendre(CAP), gauss_legendre(TURNS)
    sin = safe_sqrt((1 - cos) * (1 + cos))
    length = jnp.sqrt((alpha * sin) ** 2 + cos**2)
    x, z = alpha * sin / length, cos / length  # of the viewer, stretched
    up = 1 - jnp.asarray(u)[:, None] * (1 + z)
    out, angle = safe_sqrt((1 - up) * (1 + up)), np.pi * turn
    h_x, h_y, h_z = alpha * (out * np.cos(angle) + x), alpha * out * np.sin(angle), up + z
    norm = jnp.sqrt(h_x**2 + h_y**2 + h_z**2)
    cos_d = jnp.clip((sin * h_x + cos * h_z) / norm, 0.0, 1.0)
    cos_i = 2 * cos_d * h_z / norm - cos
    lit = cos_i > 0
    one, other = ggx.G1(cos, alpha), ggx.G1(jnp.where(lit, cos_i, 1.0), alpha)
    seen = fresnel_of_dielectric(cos_d, ratio) * height_correlated(one, other) / one
    return chebyshev.coefficients(jnp.sum(jnp.where(lit, seen, 0.0) * cap[:, None] * round_, (1, 2)))


def _gloss_table(v: Values) -> Real:
    return albedo_table(base_width(v), base_ratio(v))


def _coat_table(v: Values) -> Real:
    return albedo_table(v["coat_roughness"] ** 2, v["coat_ior"])


def _facets(v: Values, s: Setting) -> Array:
    cos_d = s.geometry.cos_d
    gloss = v["specular_color"] * fresnel_of_dielectric(cos_d, base_ratio(v))
    return mix(gloss, metal(cos_d, v["base_color"], v["specular_color"]), v["base_metalness"])


def _correlated(s: Setting, alpha: Scalar) -> Array:
    g = s.geometry
    return height_correlated(ggx.G1(g.cos_i, alpha), ggx.G1(g.cos_o, alpha)) / (4 * g.cos_i * g.cos_o)


def _coat(v: Values, s: Setting) -> Array:
    alpha, g = v["coat_roughness"] ** 2, s.geometry
    F = fresnel_of_dielectric(g.cos_d, v["coat_ior"])
    return v["coat_weight"] * F * ggx.D(g.theta_h, alpha) * _correlated(s, alpha)


def _through(v: Values, s: Setting, cos: Array) -> Array:
    """W, looked at from a direction."""
    g, n, C = s.geometry, v["coat_ior"], v["coat_weight"]
    refracted = [safe_sqrt((n - 1) * (n + 1) + x**2) / n for x in (g.cos_i, g.cos_o)]
    color = jnp.maximum(v["coat_color"], 1e-30)
    absorbed = jnp.exp(jnp.log(color) * (1 / refracted[0] + 1 / refracted[1]) / 2)
    base, rough = _base_albedo(v)
    turned_back = v["turned_back"] if "turned_back" in v else internal_diffuse_reflectance(n)
    K = mix(fresnel_of_dielectric(cos, n), turned_back, rough)
    left = 1 - chebyshev.series(v["albedo_of_coat"] if "albedo_of_coat" in v else _coat_table(v), cos)
    return mix(1.0, left * absorbed, C) * mix(1.0, (1 - K) / (1 - base * K), C)


def _left(v: Values, cos: Array) -> Array:
    """1 - E_gloss."""
    return 1 - chebyshev.series(v["albedo_of_gloss"] if "albedo_of_gloss" in v else _gloss_table(v), cos)


def _base_albedo(v: Values) -> tuple[Array, Array]:
    """Albedo of the base along the normal, about, and its effective roughness ("Darkening")."""
    ratio, M = base_ratio(v), v["base_metalness"]
    F = ((ratio - 1) / (ratio + 1)) ** 2
    dielectric = mix(v["base_color"], 1.0, F)
    rough = mix(mix(1.0, v["specular_roughness"], F), v["specular_roughness"], M)
    return mix(dielectric, v["base_color"], M), rough


def _diffuse(v: Values, s: Setting) -> Array:
    body = energy_preserving_oren_nayar(s.geometry, v["base_diffuse_roughness"], v["base_color"])
    return (1 - v["base_metalness"]) * body
