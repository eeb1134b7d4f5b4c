"""What helps a fit of a model, and that its BRDF does not depend on: starting points, strata, cheaper variants.

All of it is optional: a model of which nothing is said here starts from points of its prior (docs/extending.md).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from ...model import body as bodies
from ...model import film
from ...model.effects import BODIES
from ...model.fresnel import fresnel, fresnel_of_dielectric, schlick, schlick_of_dielectric, schlick_of_F0
from ...model.measured import Measured
from ...model.ndf.epd import HALF
from ...model.parameters import FILM, WHICH_BODY
from ...model.reflectance import Reflectance
from ...model.rivals.ashikhmin_shirley import coupled_body
from ...model.sum import Sum, lowest, over

TYPICAL = {"p": 1.0, "b": 2.0, "c": 1.5, "sigma_s": 0.03}  # of a two-scale material, where fits start
APART = 4.0  # times as wide as the highlight, or as narrow, may be the lobe of a second surface
STRATA = 3  # of every shared parameter with a logarithmic scale
_METALS = np.array(list(product(np.geomspace(0.05, 6, 14), np.geomspace(0.05, 12, 14)))).T
METALS = {"n": _METALS[0], "k": _METALS[1]}
_UNDER_FILMS = np.array(list(product(np.geomspace(0.05, 5, 8), np.geomspace(0.003, 8, 7)))).T
UNDER_FILMS = {"n": _UNDER_FILMS[0], "k": _UNDER_FILMS[1]}
DIELECTRICS = {"eta": 1 + np.geomspace(0.15, 1.55, 10)}
FACETS = {"F0": np.geomspace(0.003, 0.95, 16)}
TRIED = {
    "schlick": (FACETS, schlick_of_F0), "dielectric": (DIELECTRICS, fresnel_of_dielectric),
    "conductor": (METALS, fresnel),
}  # fmt: skip
"""By the interface of microfacets: constants that are worth a try where a fit starts, and what facets reflect."""
BODY_BRDF = {
    "none": None, "lambert": bodies.lambert_of, "plastic": bodies.plastic, "subsurface": bodies.subsurface,
}  # fmt: skip
PERFECT = (("n", 0.0), ("k", 1.0))  # index of facets that reflect everything


class StartHints(NamedTuple):
    """What data say of where to start.

    Attributes:
        half_width: tan(theta_h) where the highlight has fallen to half.
    """

    half_width: float


Start = dict[str, float]
Starts = Callable[[StartHints, float], list[Start]]


class LinearParameters(NamedTuple):
    """What parameters per channel do to a BRDF, exactly or nearly, once the shared ones are given.

        brdf = reflectance(cos_d; constants) lobes + body(cos_i, cos_o, constants, albedo)

    Attributes:
        lobes: the sharp lobes of facets that reflect everything. fixed: values per channel that make them so, by name.
        constants: values of the interface that are worth a try, (K,) each, by name.
        reflectance: of a facet, from cos_d (D,) and the constants (K, 1): (K, D). Of a film from the values of
            ``shared`` and the channels' wavelengths (C, 1, 1), too: (C, K, D).
        alike: whether all channels take the same ones.
        body: from the cosines, a constant and an albedo that broadcast against them; or None.
        body_constant: name of the constant that the body depends on, if it depends on one.
        albedo: name of the body's albedo.
        shared: names of shared parameters that the reflectance depends on.
    """

    lobes: Reflectance
    fixed: tuple[tuple[str, float], ...]
    constants: Mapping[str, np.ndarray]
    reflectance: Callable[..., Array]
    alike: bool
    body: Callable[[Array, Array, Array, Array], Array] | None = None
    body_constant: str | None = None
    albedo: str = "albedo"
    shared: tuple[str, ...] = ()


class General(NamedTuple):
    """A model of which another one is a special case: what is compiled for it serves all of its kind.

    Attributes:
        model: that one. values: its values with the same BRDF, from those of the special case. names: of its
            parameters, in the order of the special case's.
    """

    model: Reflectance
    values: Callable[[Mapping[str, ArrayLike]], dict[str, ArrayLike]]
    names: tuple[str, ...]


@dataclass(frozen=True)
class Hints:
    """What helps a fit of one model.

    Attributes:
        starts: parameters from which a fit may start, by name, channels alike, from what the data say and the
            wavelength (um) of the middle channel; what is left out has its default. The first is a guess of everything;
            what others have differently is another reading of the same data.
        strata: parameters by which minima differ, and into how many classes, equally likely, each is divided; None for
            all shared ones with a logarithmic scale.
        linear: how constants and albedos of the channels are found without a search; None if they cannot. What is per
            channel beside them starts at its default.
        search: a variant with the same parameters, in which the lowest minimum is looked for; None for the model.
    """

    starts: Starts = field(default=lambda data, middle_um: [])
    strata: Mapping[str, int] | None = None
    linear: LinearParameters | None = None
    search: Reflectance | None = None


@cache
def hints_of(model: Reflectance) -> Hints:
    """What is known of a model; of one that an apparatus sees, what is known of its material."""
    if isinstance(model, Measured):
        found = hints_of(model.material)
        linear, search = found.linear, found.search
        return replace(
            found,
            linear=linear and linear._replace(lobes=replace(model, material=linear.lobes)),
            search=search and replace(model, material=search),
        )
    if isinstance(model, Sum):
        return _sum(model)
    found = _BY_NAME[model.name](model) if model.name in _BY_NAME else Hints()
    if found.strata is not None:
        return found
    shared = [q.name for q in model.parameters if q.scale == "log" and not q.per_channel]
    return replace(found, strata=dict.fromkeys(shared, STRATA))


@cache
def general_of(model: Reflectance) -> General:
    """The model that is compiled for all of a kind: itself, or for two-scale materials one whatever the interface.

    A dielectric is a conductor with k = 0, and which body it is, is said by a number when the program runs. The
    conserving split treats kinds too differently.
    """
    material: Any = model.material if isinstance(model, Measured) else model
    names = tuple(q.name for q in model.parameters)
    base: Any = lowest(material)
    if base.name != "two-scale" or base.general == base:
        return General(model, dict, names)

    def values(v: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
        given = dict(v)
        if base.index == "real":
            given["n"] = given.pop("eta")
            given["k"] = np.zeros(np.shape(given["n"]))
        if base.body == "none":
            given["albedo"] = np.zeros(np.shape(given["n"]))
        return given | {WHICH_BODY: np.int32(BODIES.index(base.body))}

    whole: Reflectance = over(material, base.general) if isinstance(material, Sum) else base.general
    whole = replace(model, material=whole) if isinstance(model, Measured) else whole
    return General(whole, values, tuple("n" if name == "eta" else name for name in names))


def _two_scale(model: Any) -> Hints:  # noqa: ANN401 - of the class that its name says, like what follows
    """The measured highlight may be the facets' lobe, or diffracted light; the search is with the printed split.

    A diffraction lobe's half width is where 2 tan(theta_h) / lambda = 1 / b. Channels are separated nearly: with F
    instead of Q for the colour of diffracted light, and with all of that. The conserving split costs forty times as
    much on the coarse grid.
    """
    diffracts = model.diffraction != "off"

    def starts(data: StartHints, middle_um: float) -> list[Start]:
        first = {**TYPICAL, "beta": data.half_width / float(np.exp(HALF / TYPICAL["p"]))}
        if not diffracts:
            return [{name: first[name] for name in ("beta", "p")}]
        return [first, {**first, "b": middle_um / (2 * data.half_width)}]

    exact, real = model.fresnel == "exact", model.index == "real"
    of_metal, of_dielectric = (fresnel, fresnel_of_dielectric) if exact else (schlick, schlick_of_dielectric)
    filmed = model.index == "film"
    constants, formula = (DIELECTRICS, of_dielectric) if real else (METALS, of_metal)
    linear = LinearParameters(
        model.changed(body="none", index="complex", colour="fresnel", split="printed"),
        PERFECT, UNDER_FILMS if filmed else constants, of_film if filmed else formula,
        real, BODY_BRDF[model.body], "eta" if model.body in ("plastic", "subsurface") else None,
        shared=tuple(q.name for q in FILM) if filmed else (),
    )  # fmt: skip
    strata = {"beta": 3, "p": 2, **({"sigma_s": 2} if diffracts else {}), **({FILM[0].name: 4} if filmed else {})}
    return Hints(starts, strata, linear, replace(model, split="printed") if model.split == "conserving" else None)


def of_film(
    cos_d: Array, n: Array, k: Array, film_eta: Array, film_thickness: Array, wavelengths_um: ArrayLike
) -> Array:
    """Reflectance of films over matter of some constants (K, 1), as `LinearParameters` has it: (C, K, D)."""
    return film.reflectance(cos_d, n[None], k[None], film_eta, film_thickness, jnp.reshape(wavelengths_um, (-1, 1, 1)))


def _microfacets(reading: Callable[[float], Start]) -> Callable[[Any], Hints]:
    """Hints for facets whose lobe has a half width; channels separate exactly: lobes are of facets with F0 = 1."""

    def hints(model: Any) -> Hints:  # noqa: ANN401
        constants, formula = TRIED[model.fresnel]
        lobes, fixed = replace(model, fresnel="schlick"), (("F0", 1.0), ("albedo", 0.0))
        alike = model.fresnel == "dielectric"
        linear = LinearParameters(lobes, fixed, constants, formula, alike, bodies.lambert_of)
        return Hints(lambda data, middle_um: [reading(data.half_width)], linear=linear)

    return hints


def _weighted(weight: str, least: float, most: float, starts: Starts) -> Callable[[Any], Hints]:
    """Hints for a model whose channels are a weight times a lobe that all share, and a Lambert body.

    Args:
        weight: name of the parameter. least, most: between which values are tried where a fit starts.
    """
    tried = {weight: np.geomspace(least, most, 28)}

    def hints(model: Any) -> Hints:  # noqa: ANN401
        fixed = ((weight, 1.0), ("diffuse_albedo", 0.0))
        return Hints(
            starts,
            linear=LinearParameters(model, fixed, tried, _alone, False, bodies.lambert_of, None, "diffuse_albedo"),
        )

    return hints


def _scatter(weight: str, power: int, start: Callable[[float], Start]) -> Callable[[Any], Hints]:
    """Hints for a lobe of the distance x to the mirror direction, about 2 tan(theta_h), whose half is given.

    Args:
        power: of the parameter ``weight`` is the lobe's height.
    """
    tried = {weight: np.geomspace(1e-6, 1e3, 46) ** (1 / power)}

    def hints(model: Any) -> Hints:  # noqa: ANN401
        body, fixed = (None, ()) if model.diffuse == "none" else (bodies.lambert_of, (("diffuse_albedo", 0.0),))
        reflectance = _alone if power == 1 else _squared
        linear = LinearParameters(
            model, ((weight, 1.0), *fixed), tried, reflectance, False, body, None, "diffuse_albedo"
        )
        return Hints(lambda data, _: [start(2 * data.half_width)], linear=linear)

    return hints


def _squared(cos_d: Array, **weight: Array) -> Array:
    return _alone(cos_d, **weight) ** 2


def _alone(cos_d: Array, **weight: Array) -> Array:
    """The weight, whatever the angle."""
    return next(iter(weight.values())) * jnp.ones_like(cos_d)


def _interfaced(model: Any) -> Hints:  # noqa: ANN401
    """The surface exactly, the body as that of a smooth plastic."""
    found = hints_of(model.surface)
    assert found.linear is not None
    return replace(found, linear=found.linear._replace(body=bodies.plastic, body_constant="eta"))


def _oren_nayar(model: Any) -> Hints:  # noqa: ANN401
    """exp(-theta_h^2 / (2 sigma^2)) is a half at 1.18 sigma."""
    if model.surface == "none":
        return Hints()
    return Hints(lambda data, middle_um: [{"roughness": float(np.clip(data.half_width / 1.18, 2e-3, 1.4))}])


def _hp15(model: Any) -> Hints:  # noqa: ANN401
    """The highlight is the facets' lobe, and diffracted light a wide haze; or it is itself diffracted."""

    def starts(data: StartHints, middle_um: float) -> list[Start]:
        first = {"beta": data.half_width / float(np.exp(HALF)), "p": 1.0, "a": 0.9}
        return [first, {**first, "a": float(np.clip(2 * data.half_width / (0.64 * middle_um), 0.02, 40.0))}]

    return Hints(starts, {"beta": 3, "p": 2, "a": 3})


def _sum(model: Sum) -> Hints:
    """The measured highlight is that of one surface, and the other's is wider or narrower by a factor of `APART`."""
    top, base = hints_of(model.top), hints_of(model.base)
    if top.linear is None or (base.linear is None and not isinstance(model.base, Sum)):
        apart = model.top.name if top.linear is None else model.base.name
        raise ValueError(f"{apart} cannot be part of a sum: how bright its lobe is, is not separated from its shape")

    def starts(data: StartHints, middle_um: float) -> list[Start]:
        found = []
        for factor in (1 / APART, APART, 1.0):
            beside = StartHints(float(np.clip(factor * data.half_width, 2e-3, 2.0)))
            below = StartHints(float(np.clip(data.half_width * (1.0 if factor != 1.0 else APART), 2e-3, 2.0)))
            for own, of_base in product(top.starts(beside, middle_um)[:1], base.starts(below, middle_um)):
                found.append({**of_base, **{f"{name}{model.suffix}": x for name, x in own.items()}})
        return found

    of_top = {f"{name}{model.suffix}": 2 for name in top.strata or {}}
    search = base.search and replace(model, base=base.search)
    return Hints(starts, {**{name: 2 for name in base.strata or {}}, **of_top}, search=search)


def _grating(model: Any) -> Hints:  # noqa: ANN401
    """A ring lies far from the highlight, and says nothing of it; periods of everything visible are tried."""
    found = _weighted("efficiency", 0.003, 0.97, lambda data, _: [{}])(model)
    return replace(found, strata={"period": 6})


def _he_starts(data: StartHints, middle_um: float) -> list[Start]:
    """A rough surface reflects as facets of exp(-(tau tan(theta_h) / (2 sigma))^2); a smooth one diffracts.

    The latter's lobe, where sigma is a few hundredths of the wavelength, is exp(-(pi tau v_xy / lambda)^2).
    """
    rough = {"autocorrelation": 10.0, "roughness": float(np.clip(10.0 * data.half_width / 1.665, 2e-3, 19.0))}
    width = middle_um * 0.833 / (2 * np.pi * data.half_width)
    return [rough, {"autocorrelation": float(np.clip(width, 0.6, 290.0)), "roughness": 0.05}]


def _shoulder(half_width: float) -> Start:
    """Narrow shifted gamma lobes fall as (1 + tan^2 / alpha^2)^-p at first."""
    return {"alpha": min(half_width / 1.2, 1.5)}


def _ashikhmin_shirley(model: Any) -> Hints:  # noqa: ANN401
    """Exactly separated: a surface that reflects everything has no body."""
    fixed = (("F0", 1.0), ("albedo", 0.0))
    linear = LinearParameters(model, fixed, FACETS, schlick_of_F0, False, coupled_body, "F0")
    return Hints(lambda data, _: [_phong(data.half_width)], linear=linear)


def _phong(half_width: float) -> Start:
    """cos^n is a half where n tan^2 is 2 ln 2, about."""
    return {"exponent": float(np.clip(2 * np.log(2.0) / half_width**2, 1.5, 8e5))}


def _principled(rough: str, metal: str) -> Callable[[Any], Hints]:
    """Hints for Disney's model and those after it: a dielectric, or a metal; the highlight is the base's or the coat's.

    Args:
        rough: name of the square root of alpha. metal: that of the weight of the metal.
    """

    def starts(data: StartHints, middle_um: float) -> list[Start]:
        found = {rough: float(np.clip(np.sqrt(data.half_width / 0.644), 0.04, 0.95))}
        return [{**found, metal: 0.02}, {**found, metal: 0.9}, {rough: min(2.5 * found[rough], 0.9), metal: 0.02}]

    return lambda model: Hints(starts, {rough: 3})


# Where lobes are at half their peak, with t the tangent of theta_h there: t = m sqrt(ln 2), about, for Beckmann's;
# t = alpha sqrt(sqrt(2) - 1) for GGX. At C = 1 an ABC lobe is where B times its argument is 1: 1 - cos(theta_h) for
# microfacets, the square of D_p, about twice the tangent, for the smooth model.
_BY_NAME: dict[str, Callable[[Any], Hints]] = {
    "two-scale": _two_scale,
    "beckmann": _microfacets(lambda t: {"roughness": t / 0.833}),
    "ggx": _microfacets(lambda t: {"alpha": t / 0.644}),
    "gtr": _microfacets(lambda t: {"alpha": min(t / 0.644, 0.99)}),
    "epd": _microfacets(lambda t: {"beta": t / float(np.exp(HALF)), "p": 1.0}),
    "sgd-microfacet": _microfacets(_shoulder),
    "gaussian": _microfacets(lambda t: {"roughness": float(np.clip(t / 1.18, 2e-3, 0.9))}),
    "interfaced-lambertian": _interfaced,
    "abc-microfacet": _weighted("A", 0.03, 3000.0, lambda data, _: [{"B": 2 / data.half_width**2, "C": 1.0}]),
    "smooth": _weighted("A", 0.03, 3000.0, lambda data, _: [{"B": 1 / (2 * data.half_width) ** 2, "C": 1.0}]),
    "cook-torrance": _weighted("albedo", 0.003, 1.95, lambda data, _: [{"roughness": data.half_width / 0.833}]),
    "he": _weighted("albedo", 0.003, 300.0, _he_starts),
    "sgd": lambda model: Hints(lambda data, _: [_shoulder(data.half_width)], {"alpha": 3, "p": 2}),
    "hp15": _hp15,
    "student-t": _microfacets(lambda t: {"alpha": min(t / 0.644, 0.99)}),
    "ward": _weighted("albedo", 0.003, 1.95, lambda data, _: [{"alpha": min(data.half_width / 0.833, 1.4)}]),
    "blinn-phong": _weighted("albedo", 0.003, 1.95, lambda data, _: [_phong(data.half_width)]),
    "lafortune": _weighted(
        "albedo",
        0.003,
        1.95,
        lambda data, _: [{"exponent": float(np.clip(np.log(2.0) / (2 * data.half_width**2), 0.6, 8e5)), "C": 1.0}],
    ),
    "ashikhmin-shirley": _ashikhmin_shirley,
    "retro": _weighted("k_r", 0.003, 0.95, lambda data, _: [{"alpha": 0.1, "falloff": 1.0}]),
    "abg": _scatter("A", 1, lambda x: {"B": min(x**2, 5.0), "g": 2.0}),
    "harvey-shack": _scatter("b0", 1, lambda x: {"L": min(x / 1.7, 1.5), "s": 2.0}),
    "k-correlation": _scatter("sigma", 2, lambda x: {"B": 1.0 / min(x, 2.0), "s": 2.5}),
    "disney": _principled("roughness", "metallic"),
    "openpbr": _principled("specular_roughness", "base_metalness"),
    "oren-nayar": _oren_nayar,
    "grating": _grating,
}
