"""A material as an apparatus sees it: what is fitted to a measurement.

MERL's apparatus blurs, and so loses light at grazing angles (HP17 Eq. 59-60, :mod:`.acquisition`). A blurred footprint
dims what is sharp, each lobe as its width has it, and leaves the body as it is (docs/physics.md):

    rho_measured = common sum over lobes p_l(i, o) sharp_l + body,    p_l = (p_1(theta_i) p_1(theta_o))^(k_l).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from typing import ClassVar, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from . import acquisition
from .apparatus import APPARATUS, Apparatus, GrazingLoss
from .geometry import Geometry
from .parameters import WAVELENGTHS_UM, Parameter, exponent_of
from .reflectance import Factor, Lobes, Profile, Reflectance, Setting, Values, Wavelengths, lobes_of, setting


@dataclass(frozen=True)
class Measured(Reflectance):
    """A material and the loss of light at grazing angles that its measurement has; a model like the material itself.

    Attributes:
        material: the model without the apparatus.
        grazing_loss: ``off``; the exponents of all sharp lobes ``free`` (parameters); all ``derived`` from the widths
            of the lobes; or a number in [0, 1] for all. A material without sharp lobes has none: ``off``.
        apparatus: the sphere, pixel and lamp that ``derived`` assumes.
    """

    name: ClassVar[str] = "measured"
    citation: ClassVar[str] = "HP17 Section 5, Eq. 59-60"
    material: Reflectance
    grazing_loss: GrazingLoss | float = "free"
    apparatus: Apparatus = APPARATUS

    def __post_init__(self) -> None:
        """Refuse what is no loss, a loss of what has no lobes, and an apparatus that nothing uses."""
        if isinstance(self.material, Measured):
            raise ValueError(f"{self.material} is measured already")
        for lobe in self.material.lobes:
            exponent_of(lobe)
        number = isinstance(self.grazing_loss, Real) and not isinstance(self.grazing_loss, bool)
        if not (0 <= float(self.grazing_loss) <= 1 if number else self.grazing_loss in get_args(GrazingLoss)):
            raise ValueError(f"grazing_loss {self.grazing_loss!r} is neither off, free, derived nor a number in [0, 1]")
        if self.apparatus != APPARATUS and self.grazing_loss != "derived":
            raise ValueError("apparatus has an effect only where grazing_loss is derived: leave it out")
        if not self.material.lobes and self.grazing_loss not in ("free", "off", 0):
            raise ValueError(f"grazing_loss has an effect only on sharp lobes, of which {self.material} has none")
        if not self.material.lobes or self.grazing_loss == 0:
            object.__setattr__(self, "grazing_loss", "off")

    @property
    def loses(self) -> bool:
        """Whether any light is lost."""
        return self.grazing_loss != "off"

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return self.material.lobes

    @property
    def variant(self) -> str:  # noqa: D102
        return self.material.variant

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102
        declared = self.material.parameters
        if self.grazing_loss != "free":
            return declared
        shared = tuple(q for q in declared if not q.per_channel)
        return shared + tuple(map(exponent_of, self.lobes)) + declared[len(shared) :]

    def exponent(self, lobe: str, v: Values, wavelengths_um: Wavelengths = WAVELENGTHS_UM) -> Array:
        """k of one sharp lobe at these parameter values; 0 where nothing is lost."""
        if self.grazing_loss == "free":
            return v[exponent_of(lobe).name]
        if self.grazing_loss == "derived":
            table = f"{lobe}_exponent"
            return v[table] if table in v else self._derived(lobe, v, wavelengths_um)
        return jnp.asarray(float(self.grazing_loss) if self.loses else 0.0)

    def _derived(self, lobe: str, v: Values, wavelengths_um: Wavelengths) -> Array:
        return acquisition.exponent_of_lobe(profile(self.material, lobe, v, wavelengths_um), self.apparatus)

    def factors(self) -> Mapping[str, Factor]:  # noqa: D102
        losses = {f"{lobe}_loss": partial(self._loss, lobe) for lobe in self.lobes if self.loses}
        return {**self.material.factors(), **losses}

    def _loss(self, lobe: str, v: Values, s: Setting) -> Array:
        """HP17 Eq. 59-60."""
        log_base = acquisition.grazing_log_base(s.geometry) if s.log_base is None else s.log_base
        return jnp.exp(self.exponent(lobe, v, s.wavelength_um.reshape(-1)) * log_base)

    def tables(self, scattered: bool = False) -> Mapping[str, Factor]:  # noqa: D102
        lobes = self.lobes if self.grazing_loss == "derived" else ()
        exponents = {
            f"{lobe}_exponent": lambda v, s, lobe=lobe: self._derived(lobe, v, s.wavelength_um.reshape(-1))
            for lobe in lobes
        }
        return {**self.material.tables(scattered), **exponents}

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        lobes = self.material.assemble(at, s)
        if not self.loses:
            return lobes
        return lobes._replace(sharp={lobe: at[f"{lobe}_loss"] * x for lobe, x in lobes.sharp.items()})

    def __str__(self) -> str:
        """Those of the material."""
        return str(self.material)


def profile(material: Reflectance, lobe: str, v: Values, wavelengths_um: Wavelengths = WAVELENGTHS_UM) -> Array:
    """A sharp lobe over theta_h at ``acquisition.RINGS_RAD``, at theta_d = 0 and of any unit: its width matters.

    In the middle channel, whose lobe stands for all. Masking and foreshortening are left out, which vary little over a
    lobe that is narrow, and so are derivatives by parameters per channel; the masking of V-grooves stays in where it is
    part of the model's sharp lobe.
    """
    middle = np.size(wavelengths_um) // 2
    if (closed := material.lobes[lobe]) is not None:
        return closed(v, jnp.asarray(wavelengths_um)[middle])
    zero, one = jnp.zeros((1, 1)), jnp.ones((1, 1))
    s = setting(Geometry(jnp.asarray(acquisition.RINGS_RAD)[:, None], zero, one, one), wavelengths_um)
    still = jax.lax.stop_gradient
    values = {q.name: still(jnp.reshape(v[q.name], -1)) if q.per_channel else v[q.name] for q in material.parameters}
    sharp = lobes_of(material, values, s).sharp[lobe]
    return jnp.broadcast_to(sharp, (len(s.wavelength_um), len(acquisition.RINGS_RAD), 1))[middle, :, 0]


def material_of(model: Reflectance) -> Reflectance:
    """The same without what the apparatus adds."""
    return model.material if isinstance(model, Measured) else model


def with_material(model: Reflectance, material: Reflectance) -> Reflectance:
    """Another material, seen by the same apparatus."""
    if not isinstance(model, Measured):
        return material
    return replace(model, material=material) if material.lobes else Measured(material)
