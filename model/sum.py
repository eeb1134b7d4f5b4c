"""Lobes of several models over the body of the last one: coats, and surfaces of two kinds side by side.

    rho = w rho_2 + (1 - w) rho_1 + body                          ``ggx+two-scale``: a share w of the surface is another
    rho = rho_coat + (1 - F(i)) (1 - F(o)) (rho_1 + body)         ``coat(ggx)+two-scale``: F of a smooth interface

rho_1 and rho_2 are sharp lobes alone. The first is an area in which two surfaces lie side by side: together their lobes
reflect no more than the brighter one's. The second is the first order of a layered surface (Weidlich & Wilkie 2007,
"Arbitrarily layered micro-facet surfaces", doi:10.1145/1321261.1321292) that absorbs nothing, in which light keeps its
direction: refraction below the coat, and what its interface turns back from below, are left out, so that a coat over a
bright body is a little dark. Both are reciprocal. The base keeps the names of its parameters; those of what lies beside
it end in ``_2`` (``_3``), of a coat in ``_coat``.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial

import jax.numpy as jnp
from jax import Array

from .fresnel import fresnel_of_dielectric
from .parameters import Parameter, beside, exponent_of
from .priors import LogNormal
from .reads import reads
from .reflectance import Factor, Lobes, Profile, Reflectance, Setting, Values

COAT, THROUGH = "_coat", "through_coat"
MOST = 3  # parts of a sum
ROUGHEST, WIDTHS = 0.3, ("alpha", "beta", "roughness")  # width of a coat, and what it is called
SHARE = Parameter("share", "w", "share of the surface", "1", 0.5, 0.0, 1.0, "linear", source="mixture of surfaces",
                  quantity="odds")  # fmt: skip
COAT_INDEX = Parameter("eta", r"\eta", "index of refraction", "1", 1.5, 1.001, 2.6, offset=1.0,
                       source="Walter et al. 2007, Eq. 22", prior=LogNormal(0.5, 1.5))  # fmt: skip


class _Named(Mapping[str, Array]):
    """Values whose names end in a suffix, looked up without it."""

    def __init__(self, values: Values, suffix: str) -> None:
        self._values, self._suffix = values, suffix

    def __getitem__(self, name: str) -> Array:
        return self._values[name + self._suffix]

    def __contains__(self, name: object) -> bool:
        return f"{name}{self._suffix}" in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


@dataclass(frozen=True)
class Sum(Reflectance):
    """The sharp lobes of ``top`` and those of ``base``, over the body of ``base``.

    Accuracy: 1e-10 against its parts and the oracle of Fresnel's formula (``tests/rivals/test_sum.py``).

    Attributes:
        top: a model of which the sharp lobes count; a microfacet model where it is a coat. base: the rest, which may be
            a sum itself. coated: whether ``top`` is a coat, through which light has to pass on its way to the base and
            back.
    """

    top: Reflectance
    base: Reflectance
    coated: bool = False

    def __post_init__(self) -> None:
        """Refuse what has no lobe of its own to add, and coats that are no smooth interface."""
        if "substrate" in self.top.factors() or not self.top.lobes:
            raise ValueError(f"{self.top.name} has no sharp lobe that can be told from its body, and cannot be added")
        if len([*_sums(self)]) > MOST - 1:
            raise ValueError(f"{self.name} has more than {MOST} parts")
        if any(part.coated for part in _sums(self.base)):
            raise ValueError(f"{self.name}: a coat comes first, above all others")
        if self.coated:
            if not hasattr(self.top, "fresnel") or "diffraction" in vars(self.top):
                raise ValueError(f"{self.top.name} is no coat: one is facets alone, such as ggx, beckmann or epd")
            if getattr(self.top, "fresnel") == "conductor":  # noqa: B009 - of microfacets
                raise ValueError(f"{self.name}: fresnel 'conductor' is no coat's: light goes through a dielectric")
            object.__setattr__(self, "top", replace(self.top, fresnel="dielectric"))  # pyright: ignore[reportArgumentType]

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - of its parts
        """Those of its parts, as a configuration has them."""
        return f"coat({self.top.name})+{self.base.name}" if self.coated else f"{self.top.name}+{self.base.name}"

    @property
    def citation(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Those of its parts."""
        return "; ".join(dict.fromkeys((self.top.citation, self.base.citation)))

    @property
    def passed_over(self) -> frozenset[str]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What its base accepts and ignores, and the losses of its own lobes."""
        losses = frozenset(exponent_of(lobe).name for lobe in self.lobes)
        return self.base.passed_over | losses | frozenset(f"{lobe}_exponent" for lobe in self.lobes)

    @property
    def suffix(self) -> str:
        """What names of the top's parameters, tables and lobes end in."""
        if self.coated:
            return COAT
        return f"_{2 + sum(not part.coated for part in _sums(self.base))}"

    @property
    def variant(self) -> str:  # noqa: D102 - as declared in `Reflectance`, like what follows
        if lowest(self).variant == lowest(self).name:
            return self.name
        return f"{self.base.variant} + {f'coat({self.top.name})' if self.coated else self.top.name}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102
        return _parameters(self)

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102
        return {**self.base.lobes, **{f"{lobe}{self.suffix}": self._profile(lobe) for lobe in self.top.lobes}}

    def _profile(self, lobe: str) -> Profile | None:
        if (closed := self.top.lobes[lobe]) is None:
            return None
        return lambda v, middle_um: closed(_Named(v, self.suffix), middle_um)

    def factors(self) -> Mapping[str, Factor]:  # noqa: D102
        own = {name: factor for name, factor in self.top.factors().items() if name != "body"}
        through = {THROUGH: _through} if self.coated else {"share" + self.suffix: self._share}
        return {**self.base.factors(), **self._renamed(own), **through}

    def tables(self, scattered: bool = False) -> Mapping[str, Factor]:  # noqa: D102
        return {**self.base.tables(scattered), **self._renamed(self.top.tables(scattered))}

    def _renamed(self, functions: Mapping[str, Factor]) -> dict[str, Factor]:
        return {f"{name}{self.suffix}": partial(_looked_up, self.suffix, f) for name, f in functions.items()}

    def _share(self, v: Values, s: Setting) -> Array:
        return v[SHARE.name + self.suffix]

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        names = [name for name in self.top.factors() if name != "body"]
        top = self.top.assemble({**{name: at[name + self.suffix] for name in names}, "body": jnp.zeros(())}, s)
        base = self.base.assemble(at, s)
        weight = jnp.ones(()) if self.coated else at["share" + self.suffix]
        kept = at[THROUGH] if self.coated else 1 - weight

        above, below = (w if x.common is None else w * x.common for w, x in ((weight, top), (kept, base)))
        sharp = {lobe: below * x for lobe, x in base.sharp.items()}
        sharp |= {lobe + self.suffix: above * x for lobe, x in top.sharp.items()}
        return Lobes(sharp, None, kept * base.body if self.coated and base.body is not None else base.body)


def _looked_up(suffix: str, function: Factor, v: Values, s: Setting) -> Array:
    return function(_Named(v, suffix), s)


def _through(v: Values, s: Setting) -> Array:
    """(1 - F(i)) (1 - F(o)) of the coat."""
    eta = v[COAT_INDEX.name + COAT]
    return (1 - fresnel_of_dielectric(s.geometry.cos_i, eta)) * (1 - fresnel_of_dielectric(s.geometry.cos_o, eta))


def _sums(model: Reflectance) -> Iterator[Sum]:
    while isinstance(model, Sum):
        yield model
        model = model.base


@cache
def _parameters(model: Sum) -> tuple[Parameter, ...]:
    by_body = {q for q, factors in _factors_of(model.top).items() if factors <= {"body"}}
    own = [q for q in model.top.parameters if q.name not in by_body]
    own = [_of_coat(q) for q in own] if model.coated else [SHARE, *own]
    named = [
        replace(
            beside(q, model.suffix.removeprefix("_")),
            quantity=q.quantity or (q.name if q.scale == "log" and q.prior is None else None),
            shift=q.shift and replace(q.shift, of=tuple(name + model.suffix for name in q.shift.of)),
        )
        for q in own
    ]
    every = [*model.base.parameters, *named]
    return tuple(sorted(every, key=lambda q: q.per_channel))


def _of_coat(q: Parameter) -> Parameter:
    """A coat has one index, and is smooth enough to see through it as its transmittance is computed."""
    if q.name == COAT_INDEX.name:
        return COAT_INDEX
    return replace(q, default=min(q.default, ROUGHEST / 3), upper=ROUGHEST) if q.name in WIDTHS else q


def _factors_of(model: Reflectance) -> dict[str, set[str]]:
    """Names of the factors that read each parameter."""
    found = reads(model).parameters
    return {q.name: {name for name, read in found.items() if q.name in read} for q in model.parameters}


def over(model: Sum, base: Reflectance) -> Sum:
    """The same above another base, the lowest one of a sum of three."""
    return replace(model, base=over(model.base, base) if isinstance(model.base, Sum) else base)


def lowest(model: Reflectance) -> Reflectance:
    """The base of a sum that is no sum itself; any other model is its own."""
    while isinstance(model, Sum):
        model = model.base
    return model
