"""What a fit predicts, and what a file holds, at the angles that are pictured."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.interpolate import RegularGridInterpolator

from ...merl_io.azimuth import AZIMUTHS, Nodes, nodes_of
from ...merl_io.binary import Dims, Measurement
from ...merl_io.grid import MerlGrid, merl_grid
from ...model.geometry import Geometry
from ...model.measured import material_of
from ...model.parameters import WHICH_BODY
from ...model.reflectance import Reflectance, contributions, evaluate, prepared
from ..fit.hints import general_of
from ..results.schema import Model, Result
from ..support.kept import kept
from ..support.weighted import resampled

WIDEST_DEG = 89.0  # of the viewers of a lobe
BAND_DRAWS = 100  # of the posterior, for bands
PEAK_DIFFERENCE_DEG = 5.0  # theta_d of the peak
# A program each: called as they are, every operation in them is one
from_vectors, from_half_difference = map(jax.jit, (Geometry.from_vectors, Geometry.from_half_difference))


def plane_of_incidence(theta_i: float, theta_o: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors of light (at ``-x``) and viewers at signed angles, positive on the mirror's side (rad)."""
    i = np.array([-np.sin(theta_i), 0.0, np.cos(theta_i)])
    o = np.stack([np.sin(theta_o), np.zeros_like(theta_o), np.cos(theta_o)], -1)
    return np.broadcast_to(i, o.shape), o


def half_difference(i: np.ndarray, o: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rusinkiewicz angles (rad) of pairs of directions: cos_o - cos_i = 2 sin_h sin_d cos(phi_d)."""
    h = i + o
    theta_h = np.arctan2(np.hypot(h[..., 0], h[..., 1]), h[..., 2])
    theta_d = np.arctan2(np.linalg.norm(i - o, axis=-1), np.linalg.norm(h, axis=-1))
    across = 2 * np.sin(theta_h) * np.sin(theta_d)
    phi_d = np.arccos(np.clip((o[..., 2] - i[..., 2]) / np.maximum(across, 1e-12), -1, 1))
    return theta_h, theta_d, np.where(across > 1e-12, phi_d, np.pi)


def viewers(incidence_deg: float, theta_h_deg: np.ndarray, between: int = 357) -> tuple[np.ndarray, np.ndarray]:
    """Angles of viewers in the plane of incidence (deg), sorted, and which of them see a row of theta_h.

    Args:
        between: number of others, evenly spread.

    Their number is the same for every incidence: one compiled program does for all.
    """
    rows = incidence_deg + 2 * np.concatenate([-theta_h_deg, theta_h_deg])
    seen = np.abs(rows) < WIDEST_DEG
    angles = np.concatenate([np.linspace(-WIDEST_DEG, WIDEST_DEG, between), np.where(seen, rows, WIDEST_DEG)])
    order = np.argsort(angles, kind="stable")
    return angles[order], np.concatenate([np.zeros(between, bool), seen])[order]


def measured_lobe(
    measurement: Measurement, grid: MerlGrid, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> np.ndarray:
    """Measured BRDF (3, N) at some angles, linear between bin centres (for pictures only); NaN beside masked bins."""
    axes = (grid.theta_h, grid.theta_d, grid.phi_d)
    points = np.stack([np.clip(x, a[0], a[-1]) for x, a in zip((theta_h, theta_d, phi_d), axes, strict=True)], -1)
    return np.stack([RegularGridInterpolator(axes, plane)(points) for plane in measurement.values])


@dataclass(frozen=True)
class Fitted:
    """A fitted material, ready to be evaluated.

    Attributes:
        measured: what was fitted, the material as the apparatus sees it. wavelengths_um: of the channels. values: of
            the parameters of its general model (:func:`.hints.general_of`), for which alone programs are compiled, and
            tables that directions share, if there are any.
    """

    measured: Reflectance
    wavelengths_um: tuple[float, ...]
    values: Mapping[str, ArrayLike]

    @classmethod
    def of(cls, model: Model, values: Mapping[str, ArrayLike]) -> "Fitted":
        """Every direction computes all for itself."""
        return cls(model.measured, tuple(model.wavelengths_um), general_of(model.measured).values(values))

    @classmethod
    def tabled(cls, model: Model, values: Mapping[str, ArrayLike]) -> "Fitted":
        """Tables do for all directions, 99 in 100 to 1e-5 of what they would compute (`reflectance.prepared`)."""
        return cls.of_effects(model.measured, tuple(model.wavelengths_um), values)

    @classmethod
    def of_effects(
        cls, measured: Reflectance, wavelengths_um: tuple[float, ...], values: Mapping[str, ArrayLike]
    ) -> "Fitted":  # fmt: skip
        """The same of any choice of effects; what it has no use for is left out of the values."""
        general = general_of(measured)
        own = {q.name: values[q.name] for q in measured.parameters}
        return cls(measured, wavelengths_um, _prepared(general.model, wavelengths_um, general.values(own)))

    def seen_as(self, seen: Reflectance) -> tuple[Reflectance, dict[str, ArrayLike], np.ndarray]:
        """The general model of it, seen by the apparatus or not, and what it takes."""
        general = general_of(seen).model
        taken = {*(q.name for q in general.parameters), *general.tables(scattered=True), WHICH_BODY}
        kept = {name: x for name, x in self.values.items() if name in taken}
        return general, kept, np.asarray(self.wavelengths_um)


def predicted_lobe(fitted: Fitted, i: np.ndarray, o: np.ndarray, loss: bool = True) -> np.ndarray:
    """BRDF of the fitted material, (C, N): as the apparatus would have measured it, or without its loss."""
    return brdf_of(fitted, from_vectors(i, o), loss)


def brdf_of(fitted: Fitted, geometry: Geometry, loss: bool = True) -> np.ndarray:
    """BRDF of the fitted material, (C, ...): as the apparatus would have measured it, or without its loss."""
    general, values, wavelengths = fitted.seen_as(fitted.measured if loss else material_of(fitted.measured))
    return np.asarray(_compiled(general, values, geometry, wavelengths))


def parts_of(fitted: Fitted, geometry: Geometry) -> dict[str, np.ndarray]:
    """What each lobe and the body add to the material, without the apparatus, (C, ...) each; what is 0 is left out."""
    general, values, wavelengths = fitted.seen_as(material_of(fitted.measured))
    found = {name: np.asarray(x) for name, x in _parts(general, values, geometry, wavelengths).items()}
    return {name: found[name] for name in sorted(found, key=_place) if found[name].any()}


def _place(part: str) -> tuple[int, str]:
    """Sharp lobes first, the body last: compiled programs return them by the alphabet."""
    order = ("specular", "diffracted", "body")
    return (order.index(part) if part in order else 1), part


def draws_of(result: Result, chain: Mapping[str, np.ndarray]) -> Fitted:
    """Draws of the posterior, ready for :func:`band`: every array has a leading axis, tables are made once for each."""
    assert result.model is not None
    general = general_of(result.model.measured)
    every = [general.values(result.values(chain["values"][k])) for k in resampled(chain["weights"].ravel(), BAND_DRAWS)]
    stacked = {name: np.asarray([each[name] for each in every]) for name in every[0]}
    wavelengths = tuple(result.model.wavelengths_um)
    return Fitted(result.model.measured, wavelengths, _prepared_of_many(general.model, wavelengths, stacked))


def band(draws: Fitted, geometry: Geometry) -> np.ndarray:
    """5 and 95 % of what the posterior predicts for these directions, (2, C, ...)."""
    general, values, wavelengths = draws.seen_as(draws.measured)
    lobes = _compiled_of_many(general, values, geometry, wavelengths)
    return np.quantile(np.asarray(lobes), [0.05, 0.95], axis=0)


def all_bins(fitted: Fitted, dims: Dims) -> np.ndarray:
    """The fit as the apparatus would have measured it, on folded bins, (C, H, D, P/2); 0 below the horizon."""
    geometry, nodes = _rows(dims)
    return _at_bins(nodes, brdf_of(fitted, geometry), dims)


def parts_of_all_bins(fitted: Fitted, dims: Dims) -> dict[str, np.ndarray]:
    """:func:`parts_of` on folded bins."""
    geometry, nodes = _rows(dims)
    return {name: _at_bins(nodes, part, dims) for name, part in parts_of(fitted, geometry).items()}


@cache
def _rows(dims: Dims) -> tuple[Geometry, Nodes]:
    """Rows of azimuths: the model is evaluated at a few nodes of each."""
    grid = merl_grid(dims)
    half = dims[2] // 2
    nodes = nodes_of(grid.theta_h, grid.theta_d, grid.phi_d[:half], min(AZIMUTHS, half))
    angles = grid.theta_h[:, None, None], grid.theta_d[:, None], nodes.cos_i, nodes.cos_o
    return Geometry(*map(jax.device_put, angles)), nodes


def _at_bins(nodes: Nodes, values: np.ndarray, dims: Dims) -> np.ndarray:
    """A polynomial may be a little below 0 where the BRDF is next to nothing."""
    return np.where(merl_grid(dims).above[..., : dims[2] // 2], np.maximum(nodes.at_bins(values), 0.0), 0.0)


@kept(2)
def _prepared(model: Reflectance, wavelengths_um: tuple[float, ...], values: dict) -> dict[str, Array]:
    return prepared(model, values, wavelengths_um)


@kept(2)
def _prepared_of_many(model: Reflectance, wavelengths_um: tuple[float, ...], values: dict) -> dict[str, Array]:
    return jax.lax.map(lambda v: prepared(model, v, wavelengths_um), values)


@kept()
def _compiled(model: Reflectance, values: dict, geometry: Geometry, wavelengths_um: Array) -> Array:
    return evaluate(model, values, geometry, wavelengths_um)


@kept()
def _compiled_of_many(model: Reflectance, values: dict, geometry: Geometry, wavelengths_um: Array) -> Array:
    return jax.lax.map(lambda v: evaluate(model, v, geometry, wavelengths_um), values)


@kept()
def _parts(model: Reflectance, values: dict, geometry: Geometry, wavelengths_um: Array) -> dict[str, Array]:
    return contributions(model, values, geometry, wavelengths_um)
