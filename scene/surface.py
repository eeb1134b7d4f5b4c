"""What a renderer asks of a material: its BRDF for scattered directions, and how to draw them."""

from collections.abc import Mapping
from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from ..merl_io.bands import MERL, Bands
from ..model.geometry import Geometry
from ..model.numerics import safe_acos
from ..model.reflectance import Reflectance, evaluate, prepared
from ..model.sampling import Sampler
from ..model.sampling.hemisphere import Cosine
from ..model.sampling.visible import visible
from .colour import coloured

Tree = TypeVar("Tree")
MATTE = 0.5  # relative standard deviation of weights by the cosine below which nothing better is needed
facets_of = eqx.filter_jit(visible)  # a program for all materials of one model
TRIED, TRIED_FROM, GOLDEN = 4096, (0.0, 45.0, 70.0), 0.6180339887498949
PRECISION = jnp.float32  # of pictures: a relative error of 1e-5 in the BRDF


class Surface(eqx.Module):
    """A model with values and the tables that all directions share (:func:`merlfit.model.reflectance.prepared`).

    Attributes:
        model: what is simulated. values: parameters and tables. bands: that it has values of.
    """

    model: Reflectance = eqx.field(static=True)
    values: Mapping[str, Array]
    bands: Bands = eqx.field(static=True)

    def by_band(self, g: Geometry) -> Array:
        """Values of its bands, (C, ...), 1/sr: 0 where a formula of rivals is negative (Oren-Nayar's, SGD)."""
        return jnp.maximum(evaluate(self.model, self.values, g, self.bands.wavelengths_um), 0.0)

    def brdf(self, g: Geometry) -> Array:
        """R, G and B, (3, ...), 1/sr."""
        return coloured(self.by_band(g), self.bands)


class Measurement(eqx.Module):
    """A measured BRDF over MERL's angles, interpolated linearly between the centres of its bins.

    Attributes:
        values: folded at phi_d = 90 degrees, (3, 90, 90, 90), 0 where there is no datum. valid: (90, 90, 90), 1 or 0.
    """

    values: Array
    valid: Array
    bands: Bands = eqx.field(static=True, default=MERL)

    def by_band(self, g: Geometry) -> Array:
        """As `brdf`: its bands are R, G and B."""
        return self.brdf(g)

    def brdf(self, g: Geometry) -> Array:
        """Mean of the eight nearest bins that have a datum, (3, ...), 1/sr; 0 where none has, or below the horizon."""
        cos_phi = (g.cos_o - g.cos_i) / jnp.maximum(2 * jnp.sin(g.theta_h) * jnp.sin(g.theta_d), 1e-9)
        phi_d = safe_acos(jnp.minimum(jnp.abs(cos_phi), 1.0))
        quarter = jnp.pi / 2
        shape = self.valid.shape
        scaled = (jnp.sqrt(jnp.maximum(g.theta_h, 0.0) / quarter), g.theta_d / quarter, phi_d / quarter)
        total, weight = jnp.zeros((), self.values.dtype), jnp.zeros((), self.valid.dtype)
        places = [jnp.clip(x * n - 0.5, 0.0, n - 1.0) for x, n in zip(scaled, shape, strict=True)]
        cells = [jnp.clip(x.astype(jnp.int32), 0, n - 2) for x, n in zip(places, shape, strict=True)]
        shares = [x - cell for x, cell in zip(places, cells, strict=True)]
        values, valid = self.values.reshape(3, -1), self.valid.reshape(-1)
        for corner in range(8):
            steps = [(corner >> k) & 1 for k in range(3)]
            h, d, p = (cell + step for cell, step in zip(cells, steps, strict=True))
            index = (h * shape[1] + d) * shape[2] + p
            each = valid[index]
            for step, share in zip(steps, shares, strict=True):
                each = each * (share if step else 1 - share)
            total, weight = total + each * values[:, index], weight + each
        above = (g.cos_i > 0) & (g.cos_o > 0)
        return jnp.where(above & (weight > 0), total / jnp.where(weight > 0, weight, 1.0), 0.0)


Material = Surface | Measurement
Drawn = tuple[Material, Sampler]
"""A material and the sampler of its directions."""


def surface(
    model: Reflectance, values: Mapping[str, ArrayLike], bands: Bands = MERL, known: Mapping[str, Array] | None = None
) -> Surface:  # fmt: skip
    """A material prepared for scattered directions, its tables computed in float64 and kept in :data:`PRECISION`.

    Args:
        known: tables that need not be computed.
    """
    own, there = {q.name: jnp.asarray(values[q.name], float) for q in model.parameters}, known or {}
    missing = tuple(name for name in model.tables(scattered=True) if name not in there)
    found = _prepared(model, own, bands.wavelengths_um, missing) if missing else {}
    return Surface(model, _in_precision({**own, **found, **there}), bands)


@partial(jax.jit, static_argnums=(0, 2, 3))
def _prepared(
    model: Reflectance, values: Mapping[str, Array], wavelengths_um: tuple[float, ...], names: tuple[str, ...]
) -> dict[str, Array]:
    found = prepared(model, values, wavelengths_um)
    return {name: found[name] for name in names}


def measurement(values: np.ndarray, valid: np.ndarray) -> Measurement:
    """From folded values (3, 90, 90, 90) and which of them are data (90, 90, 90)."""
    values = np.where(valid, values, 0.0)
    return Measurement(jnp.asarray(values, PRECISION), jnp.asarray(valid, PRECISION))


def drawn(material: Material) -> Drawn:
    """With the sampler that suits it: the cosine where that is good enough, which is quick, or visible facets."""
    matte = isinstance(material, Surface) and not material.model.lobes
    if matte or float(_uneven(material)) < MATTE:
        return material, Cosine()
    return material, _in_precision(facets_of(material.brdf))


@eqx.filter_jit
def _uneven(material: Material) -> Array:
    """Relative standard deviation of BRDF cos / density by the cosine's density; the largest of some directions."""
    k = jnp.arange(TRIED, dtype=PRECISION) + 0.5
    u = jnp.stack([k / TRIED, (k * GOLDEN) % 1.0], -1)
    theta = jnp.radians(jnp.asarray(TRIED_FROM, PRECISION))[:, None]
    given = jnp.stack([jnp.sin(theta), 0 * theta, jnp.cos(theta)], -1)
    to = Cosine().draw(jnp.broadcast_to(given, (len(TRIED_FROM), TRIED, 3)), u)
    weight = jnp.mean(material.brdf(Geometry.from_vectors(jnp.broadcast_to(given, to.shape), to)), 0)
    mean = jnp.mean(weight, 1)
    return jnp.max(jnp.where(mean > 0, jnp.std(weight, 1) / jnp.where(mean > 0, mean, 1.0), 0.0))


def _in_precision(tree: Tree) -> Tree:
    return jax.tree.map(lambda x: jnp.asarray(x, PRECISION), tree)
