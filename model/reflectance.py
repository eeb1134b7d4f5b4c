"""The contract of a reflectance model, and its evaluation.

A model is a frozen, hashable value: its settings are its fields, and equal models are equal programs. Its BRDF is put
together from factors, each a function of some parameters and of a part of the directions. On a grid a factor of theta_h
alone is computed for every theta_h, not for every bin, and is differentiated only by the parameters that it looks up
(:mod:`.reads`). A model is a material; what an apparatus sees of it, :class:`.measured.Measured`, is a model, too.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import reduce
from operator import add
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from .effects import Effects
from .geometry import Geometry
from .numerics import floats
from .parameters import LOSSES, WAVELENGTHS_UM, WHICH_BODY, Parameter

Values = Mapping[str, Array]
Wavelengths = ArrayLike | Sequence[float]


class Setting(NamedTuple):
    """What depends on neither model nor parameters: directions, and wavelengths with a leading axis."""

    geometry: Geometry  # with cosines of directions below the horizon replaced by 1
    above: Array
    wavelength_um: Array  # shape (C, 1, ..., 1)
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
        whole = reduce(add, self.sharp.values()) if self.sharp else None
        if whole is not None and self.common is not None:
            whole = self.common * whole
        if self.body is not None:
            whole = self.body if whole is None else whole + self.body
        brdf = jnp.where(s.above, 0.0 if whole is None else whole, 0.0).astype(jnp.result_type(s.geometry.theta_h))
        return jnp.broadcast_to(brdf, jnp.broadcast_shapes(brdf.shape, s.wavelength_um.shape))


Factor = Callable[[Values, Setting], Array]
Profile = Callable[[Values, Array], Array]


class Reflectance(ABC):
    """A reflectance model. Subclasses are frozen dataclasses, static under jit; their fields are their settings.

    Attributes:
        name: in configurations and results. citation: where the model is from. bodies: what may lie under its surface.
        passed_over: names of values that are accepted and ignored, so that what was fitted to a measurement can be
            evaluated without the apparatus.
    """

    name: ClassVar[str]
    citation: ClassVar[str]
    bodies: ClassVar[tuple[str, ...]] = ("lambert",)
    passed_over: ClassVar[frozenset[str]] = frozenset(
        [*(q.name for q in LOSSES.values()), *(f"{lobe}_exponent" for lobe in LOSSES)]
    )

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Those that are fitted, shared ones first, per-channel ones last."""

    @property
    def lobes(self) -> Mapping[str, Profile | None]:
        """The sharp lobes by name, a key of `LOSSES`: an apparatus dims them, each as its width has it, but no body.

        What a name has is the lobe over theta_h at ``acquisition.RINGS_RAD``, in any unit, as a function of parameters
        and of the wavelength (um) of the middle channel; None: `measured.profile` evaluates the model there.
        """
        return {"specular": None}

    @abstractmethod
    def factors(self) -> Mapping[str, Factor]:
        """What the BRDF is put together from, by name; arrays that broadcast against the directions.

        They look parameters and tables up by name, and never go over all values: what is looked up is what they read.
        """

    def tables(self, scattered: bool = False) -> Mapping[str, Factor]:
        """What depends on parameters and on theta_d at the most, so that many directions can share it.

        Code that evaluates directions in blocks computes it once and passes it on with the values; other code does not,
        so that a factor must do without its table, too. Parameters per channel come as ``(C,)`` or with more axes of
        length one.

        Args:
            scattered: over nodes of their own, whatever the directions, instead of at each theta_d.
        """
        return {}

    @abstractmethod
    def assemble(self, at: Values, s: Setting) -> Lobes:
        """The sharp lobes and the body from the values of the factors."""

    @property
    def variant(self) -> str:
        """Short words for tables, by which variants of a model are told apart: its settings that are not the usual."""
        changed = [
            (field.name, str(value))
            for field in fields(self)  # pyright: ignore[reportArgumentType] - models are dataclasses
            if (value := getattr(self, field.name)) != field.default
        ]
        words = [value if value[0].isalpha() and value != "none" else f"{name} {value}" for name, value in changed]
        return " ".join([self.name, *words])

    def __str__(self) -> str:
        """Name and variant."""
        return self.name if self.variant == self.name else f"{self.name} ({self.variant})"


class OneFormula(Reflectance):
    """Base of models that are one formula: what is ``sharp`` and what is the ``body``, each by all its parameters.

    A model without one of them leaves its method out.
    """

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102 - as declared, like what follows
        return {} if type(self).sharp is OneFormula.sharp else super().lobes

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


def setting(geometry: Geometry, wavelengths_um: Wavelengths = WAVELENGTHS_UM, log_base: Array | None = None) -> Setting:
    """Directions made safe to compute with, and wavelengths with a leading axis; ``log_base`` if it is known."""
    theta_h, theta_d, cos_i, cos_o = floats(geometry.theta_h, geometry.theta_d, geometry.cos_i, geometry.cos_o)
    above = (cos_i > 0) & (cos_o > 0)
    cos_i, cos_o = jnp.where(above, cos_i, 1.0), jnp.where(above, cos_o, 1.0)
    rank = len(jnp.broadcast_shapes(theta_h.shape, theta_d.shape, above.shape))
    wavelength = jnp.asarray(wavelengths_um, jnp.result_type(theta_h)).reshape((-1,) + (1,) * rank)
    return Setting(Geometry(theta_h, theta_d, cos_i, cos_o), above, wavelength, log_base)


def shaped(model: Reflectance, params: Mapping[str, ArrayLike], s: Setting) -> dict[str, Array]:
    """Parameters in the precision of the angles, those per channel with a leading axis; tables and body if given.

    Raises:
        KeyError: a parameter of the model is missing, or a name is unknown.
        ValueError: a parameter has values for another number of channels, or several where all channels share it.
    """
    names = [q.name for q in model.parameters]
    extra = {*model.tables(), *model.tables(scattered=True), WHICH_BODY}
    if missing := [name for name in names if name not in params]:
        raise KeyError(f"{model} needs {', '.join(missing)}: {model!r}")
    if unknown := params.keys() - extra - {*names} - innermost(model).passed_over:
        raise KeyError(f"{model} has no parameter {', '.join(sorted(unknown))}")
    channels = s.wavelength_um.shape[0]
    for q in model.parameters:
        wanted, count = channels if q.per_channel else 1, np.size(params[q.name])
        if count not in (1, wanted):
            needed = f"{wanted} values" if q.per_channel else "one value"
            raise ValueError(f"{model} needs {needed} of {q.name}, not {count}")
    precision = jnp.result_type(s.geometry.theta_h)
    shared = {
        name: jnp.asarray(x) if name == WHICH_BODY else jnp.asarray(x).astype(precision)
        for name, x in params.items()
        if name in extra
    }
    return shared | {
        q.name: jnp.asarray(params[q.name], precision).reshape(
            (-1, *s.wavelength_um.shape[1:]) if q.per_channel else ()
        )
        for q in model.parameters
    }


def innermost(model: Reflectance) -> Reflectance:
    """The material of a model that is made of another one's."""
    while isinstance(material := getattr(model, "material", None), Reflectance):
        model = material
    return model


def of_order(model: Reflectance, order: int) -> Reflectance:
    """The same with quadratures of no higher order, and without the tier that takes hours."""
    parts = {name: x for name, x in vars(model).items() if isinstance(x, Reflectance)}
    if parts:
        return replace(model, **{name: of_order(x, order) for name, x in parts.items()})  # pyright: ignore[reportArgumentType] - models are dataclasses
    if not isinstance(model, Effects):
        return model
    tier = "quadrature" if model.diffraction == "exact" else model.diffraction
    return model.changed(diffraction=tier, order=min(order, model.order))


def factor_values(model: Reflectance, values: Values, s: Setting) -> dict[str, Array]:
    """Every factor by name, of values from :func:`shaped`."""
    return {name: factor(values, s) for name, factor in model.factors().items()}


def lobes_of(model: Reflectance, params: Mapping[str, ArrayLike], s: Setting) -> Lobes:
    """Lobes and body; errors as of :func:`shaped`."""
    return model.assemble(factor_values(model, shaped(model, params, s), s), s)


def evaluate(
    model: Reflectance,
    params: Mapping[str, ArrayLike],
    geometry: Geometry,
    wavelengths_um: Wavelengths = WAVELENGTHS_UM,
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
    s = setting(geometry, wavelengths_um)
    return lobes_of(model, params, s).brdf(s)


def contributions(
    model: Reflectance,
    params: Mapping[str, ArrayLike],
    geometry: Geometry,
    wavelengths_um: Wavelengths = WAVELENGTHS_UM,
) -> dict[str, Array]:
    """What each sharp lobe and the ``body`` add to the BRDF (1/sr): :func:`evaluate`, whose arguments it has, sums."""
    s = setting(geometry, wavelengths_um)
    lobes = lobes_of(model, params, s)
    parts = {name: Lobes({name: lobe}, lobes.common) for name, lobe in lobes.sharp.items()}
    if lobes.body is not None:
        parts["body"] = Lobes({}, body=lobes.body)
    return {name: part.brdf(s) for name, part in parts.items()}


def prepared(
    model: Reflectance, params: Mapping[str, ArrayLike], wavelengths_um: Wavelengths = WAVELENGTHS_UM
) -> dict[str, Array]:
    """Parameters and what many scattered directions share of them: :func:`evaluate` takes them, and looks up.

    A renderer asks for millions of directions of one material; so each costs what it costs on a grid.
    """
    one = jnp.ones((1,))
    s = setting(Geometry(0 * one, 0 * one, one, one), wavelengths_um)
    values = shaped(model, params, s)
    tables = {name: table(values, s) for name, table in model.tables(scattered=True).items()}
    return {name: jnp.asarray(x) for name, x in params.items()} | tables
