"""What a fit needs of a reflectance model, and nothing else knows more: :class:`Reflectance`.

A model is a frozen, hashable value: its settings are its fields, and equal models are equal programs. Its BRDF is put
together from factors, each a function of some of the parameters and of a part of the directions. On a grid a factor of
theta_h alone is computed for every theta_h, not for every bin, and a factor is differentiated only by the parameters
that it reads. Which these are is found by recording what it asks for (:func:`reads`).

A model is a material. What an apparatus makes of it is :class:`merlfit.model.measured.Measured`, a model, too.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, reduce
from operator import add
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from .acquisition import RINGS_RAD
from .effects import LEAST_ORDER
from .geometry import Geometry
from .numerics import floats
from .parameters import LOSSES, WAVELENGTHS_UM, Parameter

Values = Mapping[str, Array]
Wavelengths = ArrayLike | Sequence[float]


class Setting(NamedTuple):
    """What does not depend on parameters: directions, wavelengths (leading axis) and the model with its settings."""

    geometry: Geometry  # with cosines of directions below the horizon replaced by 1
    above: Array
    wavelength_um: Array  # shape (C, 1, ..., 1)
    model: "Reflectance"
    log_base: Array | None  # of the acquisition's loss (acquisition.grazing_log_base), if it is known already


class Lobes(NamedTuple):
    """What a BRDF is the sum of (1/sr): ``common`` times every sharp lobe, and the body.

    Attributes:
        sharp: lobes by name, (C, ...) or what broadcasts to it. common: factor of all of them. body: None for none.
    """

    sharp: Mapping[str, Array]
    common: Array | None = None
    body: Array | None = None

    def brdf(self, s: Setting) -> Array:
        """The sum, shape ``(C, ...)`` in the precision of the angles; 0 below the horizon."""
        found = reduce(add, self.sharp.values()) if self.sharp else None
        if found is not None and self.common is not None:
            found = self.common * found
        if self.body is not None:
            found = self.body if found is None else found + self.body
        brdf = jnp.where(s.above, 0.0 if found is None else found, 0.0).astype(jnp.result_type(s.geometry.theta_h))
        return jnp.broadcast_to(brdf, jnp.broadcast_shapes(brdf.shape, s.wavelength_um.shape))


Factor = Callable[[Values, Setting], Array]


class Reflectance(ABC):
    """A reflectance model. Subclasses are frozen dataclasses, static under jit; their fields are their settings.

    ``name`` is that in configurations and results, ``citation`` where the model is from, ``bodies`` what may lie under
    its surface, ``lobes`` the names of its sharp lobes: keys of :data:`merlfit.model.parameters.LOSSES`.
    """

    name: ClassVar[str]
    citation: ClassVar[str]
    bodies: ClassVar[tuple[str, ...]] = ("lambert",)

    @property
    def lobes(self) -> tuple[str, ...]:
        """Names of the sharp lobes; an apparatus that blurs dims them, and leaves the body as it is."""
        return ("specular",)

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Those that are fitted, shared ones first, per-channel ones last."""

    @abstractmethod
    def factors(self) -> Mapping[str, Factor]:
        """What the BRDF is put together from, by name; arrays that broadcast against the directions.

        They look parameters and tables up by name, and never go over all values: what is looked up is what they read.
        """

    @abstractmethod
    def assemble(self, at: Values, s: Setting) -> Lobes:
        """The sharp lobes and the body from the values of the factors."""

    @property
    def variant(self) -> str:
        """Short words for tables, by which those variants of a model that a fit compares are told apart."""
        return self.name

    @classmethod
    def variants(cls) -> "tuple[Reflectance, ...]":
        """Those that a fit may compare, the simplest first."""
        return (cls(),)

    @property
    def words(self) -> str:
        """What it is, for people."""
        return str(self)

    @property
    def details(self) -> tuple[str, ...]:
        """Those of its settings that matter, in words."""
        return ()

    @property
    def objection(self) -> str | None:
        """Why no fit can be of this model with these settings, in words; None of all others."""
        return None

    def profile(self, lobe: str, v: Values, wavelengths_um: Wavelengths = WAVELENGTHS_UM) -> Array:
        """A sharp lobe over theta_h at ``acquisition.RINGS_RAD``, at theta_d = 0 and of any unit: its width matters.

        In the middle channel, whose lobe stands for all. Masking and foreshortening are left out, which vary little
        over a lobe that is narrow, and so are derivatives by parameters per channel; the masking of V-grooves stays in
        where it is part of the model's ``sharp``.
        """
        zero, one = jnp.zeros((1, 1)), jnp.ones((1, 1))
        s = setting(Geometry(jnp.asarray(RINGS_RAD)[:, None], zero, one, one), self, wavelengths_um)
        still = jax.lax.stop_gradient
        own = {q.name: still(jnp.reshape(v[q.name], -1)) if q.per_channel else v[q.name] for q in self.parameters}
        found = self.assemble(factor_values(shaped(own, s), s), s).sharp[lobe]
        channels = len(s.wavelength_um)
        return jnp.broadcast_to(found, (channels, len(RINGS_RAD), 1))[channels // 2, :, 0]

    def tables(self, scattered: bool = False) -> Mapping[str, Factor]:
        """What depends on parameters and on theta_d at the most, so that many directions can share it.

        Code that evaluates directions in blocks computes it once and passes it on with the values; other code does not,
        so that a factor must do without its table, too. Parameters per channel come as ``(C,)`` or with more axes of
        length one.

        Args:
            scattered: over nodes of their own, whatever the directions, instead of at each theta_d.
        """
        return {}

    def cheap_variant(self, order: int) -> "Reflectance":
        """A cheaper variant with the same parameters; ``order``: of its quadratures, at the most."""
        return self

    @property
    def switches(self) -> Mapping[str, int]:
        """Whole numbers by name, with an example each, that are given among the values and are no parameters."""
        return {}

    def ignored(self) -> frozenset[str]:
        """Names of parameters that other settings have: values of theirs are not refused, but not used either.

        So what was fitted to a measurement may be evaluated without the apparatus.
        """
        return frozenset(q.name for q in LOSSES.values())

    def __str__(self) -> str:
        """Name and variant."""
        return self.name if self.variant == self.name else f"{self.name} ({self.variant})"


class OneFormula(Reflectance):
    """Base of models that are one formula: what is ``sharp`` and what is the ``body``, each by all its parameters.

    A model without one of them leaves its method out.
    """

    @property
    def lobes(self) -> tuple[str, ...]:  # noqa: D102 - as declared, like what follows
        return () if type(self).sharp is OneFormula.sharp else super().lobes

    def sharp(self, v: Values, s: Setting) -> Array:
        """Light reflected by the surface (1/sr), ``(C, ...)``."""
        return jnp.zeros(())

    def body(self, v: Values, s: Setting) -> Array:
        """Light from below it (1/sr)."""
        return jnp.zeros(())

    def factors(self) -> Mapping[str, Factor]:  # noqa: D102 - as declared
        return {**{lobe: self.sharp for lobe in self.lobes}, "body": self.body}

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        return Lobes({lobe: at[lobe] for lobe in self.lobes}, body=at["body"])


def setting(
    geometry: Geometry,
    model: Reflectance,
    wavelengths_um: ArrayLike | Sequence[float] = WAVELENGTHS_UM,
    log_base: Array | None = None,
) -> Setting:
    """Directions made safe to compute with, and wavelengths with a leading axis.

    Args:
        log_base: :func:`merlfit.model.acquisition.grazing_log_base` of the directions, if it is known already.
    """
    theta_h, theta_d, cos_i, cos_o = floats(geometry.theta_h, geometry.theta_d, geometry.cos_i, geometry.cos_o)
    above = (cos_i > 0) & (cos_o > 0)
    cos_i, cos_o = jnp.where(above, cos_i, 1.0), jnp.where(above, cos_o, 1.0)
    rank = len(jnp.broadcast_shapes(theta_h.shape, theta_d.shape, above.shape))
    wavelength = jnp.asarray(wavelengths_um, jnp.result_type(theta_h)).reshape((-1,) + (1,) * rank)
    return Setting(Geometry(theta_h, theta_d, cos_i, cos_o), above, wavelength, model, log_base)


def evaluate(
    model: Reflectance,
    params: Mapping[str, ArrayLike],
    geometry: Geometry,
    wavelengths_um: ArrayLike | Sequence[float] = WAVELENGTHS_UM,
) -> Array:
    """BRDF (1/sr) of any model, shape ``(C, *broadcast shape of geometry)``; 0 below the surface.

    Args:
        params: values by name: scalars, and arrays of shape ``(C,)`` for those that are per channel.
        geometry: directions, scattered or as a broadcast grid.
        wavelengths_um: shape ``(C,)``, in micrometres.

    Raises:
        KeyError: a parameter of the model is missing from ``params``, or one there is unknown.
        ValueError: a parameter has values for another number of channels, or several where all channels share it.
    """
    s = setting(geometry, model, wavelengths_um)
    return assembled(shaped(params, s), s)


def contributions(
    model: Reflectance,
    params: Mapping[str, ArrayLike],
    geometry: Geometry,
    wavelengths_um: ArrayLike | Sequence[float] = WAVELENGTHS_UM,
) -> dict[str, Array]:
    """What each sharp lobe and the ``body`` add to the BRDF (1/sr): :func:`evaluate` is their sum.

    Args and errors: as of :func:`evaluate`, and so is the shape of each.
    """
    s = setting(geometry, model, wavelengths_um)
    lobes = model.assemble(factor_values(shaped(params, s), s), s)
    found = {name: Lobes({name: lobe}, lobes.common).brdf(s) for name, lobe in lobes.sharp.items()}
    return found if lobes.body is None else found | {"body": Lobes({}, body=lobes.body).brdf(s)}


def prepared(
    model: Reflectance, params: Mapping[str, ArrayLike], wavelengths_um: ArrayLike | Sequence[float] = WAVELENGTHS_UM
) -> dict[str, Array]:
    """Parameters and what many scattered directions share of them: :func:`evaluate` takes them, and looks up.

    A renderer asks for millions of directions of one material; so each costs what it costs on a grid.
    """
    one = jnp.ones((1,))
    s = setting(Geometry(0 * one, 0 * one, one, one), model, wavelengths_um)
    values = shaped(params, s)
    found = {name: jnp.asarray(x) for name, x in params.items()}
    return found | {name: compute(values, s) for name, compute in model.tables(scattered=True).items()}


def assembled(values: Values, s: Setting) -> Array:
    """:func:`evaluate` of values from :func:`shaped`: the BRDF (1/sr)."""
    return s.model.assemble(factor_values(values, s), s).brdf(s)


def factor_values(values: Values, s: Setting) -> dict[str, Array]:
    """Every factor by name."""
    return {name: factor(values, s) for name, factor in s.model.factors().items()}


def shaped(params: Mapping[str, ArrayLike], s: Setting) -> dict[str, Array]:
    """Parameters in the precision of the angles, those per channel with a leading axis; tables if given."""
    model = s.model
    needed = [q.name for q in model.parameters]
    extra = [*model.tables(), *model.tables(scattered=True), *model.switches]
    if missing := [name for name in (*needed, *model.switches) if name not in params]:
        raise KeyError(f"{model} needs {', '.join(missing)}: {model!r}")
    if unknown := params.keys() - model.ignored() - {*needed, *extra}:
        raise KeyError(f"{model} has no parameter {', '.join(sorted(unknown))}")
    channels = s.wavelength_um.shape[0]
    for q in model.parameters:
        wanted, count = channels if q.per_channel else 1, np.size(params[q.name])
        if count not in (1, wanted):
            needed = f"{wanted} values" if q.per_channel else "one value"
            raise ValueError(f"{model} needs {needed} of {q.name}, not {count}")
    precision = jnp.result_type(s.geometry.theta_h)
    given = {name: jnp.asarray(params[name]) for name in extra if name in params}
    given = {name: x if name in model.switches else x.astype(precision) for name, x in given.items()}
    return given | {
        q.name: jnp.asarray(params[q.name], precision).reshape(
            (-1, *s.wavelength_um.shape[1:]) if q.per_channel else ()
        )
        for q in model.parameters
    }


class _Recorder(Mapping[str, Array]):
    """Values, and which of them were looked up.

    It is empty to iterate over: type checkers go over all values, and every factor would seem to read all of them.
    """

    def __init__(self, values: Values) -> None:
        self._values = values
        self.asked: set[str] = set()

    def __getitem__(self, name: str) -> Array:
        found = self._values[name]
        self.asked.add(name)
        return found

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


class Reads(NamedTuple):
    """What a model's factors and tables look up, by their names: parameters, and tables."""

    parameters: Mapping[str, tuple[str, ...]]
    tables: Mapping[str, tuple[str, ...]]


def reads(model: Reflectance, scattered: bool = False) -> Reads:
    """Found by evaluating them once, abstractly; a factor that looks up a table reads the table's parameters, too.

    Args:
        scattered: as of `Reflectance.tables`.
    """
    cheap = model.cheap_variant(LEAST_ORDER)  # on which it does not depend, unless that has other factors
    return _reads(cheap if cheap.factors().keys() == model.factors().keys() else model, scattered)


@cache
def _reads(model: Reflectance, scattered: bool) -> Reads:
    names, tables = [q.name for q in model.parameters], model.tables(scattered)
    angle = np.full((1, 1, 1), 0.3)
    example = {
        q.name: np.full(len(WAVELENGTHS_UM), q.default) if q.per_channel else q.default for q in model.parameters
    }
    asked: dict[str, set[str]] = {}

    def look(params: Mapping[str, Array]) -> dict[str, Array]:
        s = setting(Geometry.from_half_difference(angle, angle, angle), model)
        values = dict(shaped(params, s))
        found: dict[str, Array] = {}
        for kind, functions in (("table", tables), ("factor", model.factors())):
            for name, compute in functions.items():
                recorder = _Recorder(values)
                found[f"{kind} {name}"] = compute(recorder, s)
                asked[f"{kind} {name}"] = recorder.asked
            values |= {name: found[f"table {name}"] for name in tables}
        return found

    jax.eval_shape(look, {**example, **model.switches})
    of_tables = {name: asked[f"table {name}"] for name in tables}
    looked_up = {name: tuple(t for t in tables if t in asked[f"factor {name}"]) for name in model.factors()}
    read = {
        name: asked[f"factor {name}"].union(*(of_tables[t] for t in looked_up[name])) for name in model.factors()
    } | of_tables
    return Reads({name: tuple(q for q in names if q in each) for name, each in read.items()}, looked_up)
