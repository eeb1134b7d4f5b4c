"""Total integrated scatter (TIS): what comes back of the light from one direction, of the file and of the fit.

It is the directional-hemispherical reflectance, the integral of the BRDF times cos theta_o over all viewers.
"""

from collections.abc import Mapping

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.spatial import SphericalVoronoi

from ...merl_io.bands import Bands
from ...merl_io.binary import Measurement
from ...merl_io.grid import merl_grid
from ...merl_io.hints import cover_hemisphere
from ...merl_io.inputs import Input
from ...merl_io.scattered import ScatteredMeasurement
from ...model.albedo import directional_albedo
from ...model.parameters import WHICH_BODY
from ...model.reflectance import Reflectance
from ..support.choices import THETA_MAX
from ..support.kept import kept
from ..support.threads import side_by_side
from .hints import general_of

COUNT = 4  # incidences that are stated at the most
WIDTH, AT_ONCE = 4, 2  # incidences beside a set of parameters, and so many such pairs in a call: one program for all
STEP, LEAST = 1e-4, 1e-3  # of differences that are slopes, relative to a parameter, or to so much of a linear one
USUAL = np.radians([0.0, 30.0, 60.0])  # of a file that has none of its own
FEWEST = 8  # samples of an incidence of the file's own
SAME = 1e-4  # rad: incidences that differ by less are one
BAND = np.radians(2.5)  # around an incidence: bins that count for it
APART = 4  # digits of the coordinates of directions by which they differ


def incidences_of(measured: Input) -> np.ndarray:
    """Incidences (rad) at which it is stated: the file's own, evenly chosen where it has many, or the usual ones."""
    if isinstance(measured, Measurement):
        return USUAL
    place = np.round(measured.theta_i / SAME).astype(int)
    _, first, count = np.unique(place, return_index=True, return_counts=True)
    own = measured.theta_i[first]
    own = own[(count >= FEWEST) & (own <= THETA_MAX)]
    if not len(own):
        return USUAL
    return own[np.unique(np.round(np.linspace(0, len(own) - 1, COUNT)).astype(int))]


def of_file(measured: Input, theta_i: np.ndarray) -> np.ndarray:
    """TIS of a file's own values at incidences (rad), (A,): (C, A), NaN where its samples do not cover the hemisphere.

    Of bins, those within 2.5 degrees of the incidence are averaged with their weights. Scattered samples count with
    the solid angles of their format, and what is beyond them as 0; of a list of directions each counts with its cell of
    the hemisphere's Voronoi diagram, so that what is beyond the samples is as bright as the nearest of them.
    """
    of_one = _of_bins if isinstance(measured, Measurement) else _of_samples
    return np.stack([of_one(measured, float(theta)) for theta in theta_i], -1)  # pyright: ignore[reportArgumentType]


def _of_bins(measured: Measurement, theta_i: float) -> np.ndarray:
    grid, bins = merl_grid(measured.dims), measured.values
    near = measured.valid & grid.above & (np.abs(np.arccos(np.clip(grid.cos_i, -1, 1)) - theta_i) < BAND)
    light = grid.weight[near] * grid.cos_o[near]
    return np.pi * (bins[:, near] @ light) / light.sum() if near.any() else np.full(len(bins), np.nan)


def _of_samples(measured: ScatteredMeasurement, theta_i: float) -> np.ndarray:
    rows = np.flatnonzero(np.abs(measured.theta_i - theta_i) < SAME)
    theta_o, phi, values = measured.theta_o[rows], measured.phi[rows], measured.values[:, rows]
    if not cover_hemisphere(theta_o, phi):
        return np.full(len(values), np.nan)
    if measured.solid_angle is not None:
        return np.nan_to_num(values) @ (np.cos(theta_o) * measured.solid_angle[rows])
    masks, which = np.unique(np.isfinite(values), axis=0, return_inverse=True)  # of all channels mostly the same
    cells = [_cells(theta_o[there], phi[there]) for there in masks]
    return np.array([plane[masks[k]] @ cells[k] for plane, k in zip(values, which, strict=True)])


def _cells(theta_o: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """What each of a list of directions counts for, (N,): its solid angle times its cosine; NaN where they are few."""
    if not cover_hemisphere(theta_o, phi):
        return np.full(len(phi), np.nan)
    return np.cos(theta_o) * solid_angles(theta_o, phi)


def solid_angles(theta_o: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Part of the hemisphere (sr) that is nearer to each direction, or its mirror image, than to the others, (N,).

    Their images below the horizon make it the boundary. Directions that are there several times share their part.
    """
    x, y, z = np.sin(theta_o) * np.cos(phi), np.abs(np.sin(theta_o) * np.sin(phi)), np.cos(theta_o)
    images = [[x, s * y, t * z] for s in (1, -1) for t in (1, -1)]
    place = np.round(np.moveaxis(np.array(images), 1, -1).reshape(-1, 3), APART) + 0.0
    points, at, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    area = SphericalVoronoi(points / np.linalg.norm(points, axis=1, keepdims=True)).calculate_areas()
    return (area / count)[at].reshape(len(images), -1).sum(0) / 2


def of_values(material: Reflectance, values: Mapping[str, np.ndarray], bands: Bands, theta_i: np.ndarray) -> np.ndarray:
    """TIS of n sets of parameters, with a leading axis (n,), at incidences (rad), one or more, (A,): (n, C, A).

    Without the apparatus. One program for all variants of a model (:func:`.hints.general_of`) and any incidences, 20 ms
    for each set and `WIDTH` of them.
    """
    general, wavelengths = general_of(material), np.array(bands.wavelengths_um)
    own = {q.name: np.asarray(values[q.name], float) for q in material.parameters}
    (count,) = {len(x) for x in own.values()}
    groups = np.resize(theta_i, (-(-len(theta_i) // WIDTH), WIDTH))
    pairs = np.arange(-(-count * len(groups) // AT_ONCE) * AT_ONCE) % (count * len(groups))

    def of_some(some: np.ndarray) -> np.ndarray:
        part = general.values({name: x[some // len(groups)] for name, x in own.items()})
        return np.asarray(_of_many(general.model, part, wavelengths, groups[some % len(groups)]))

    found = np.concatenate(side_by_side(of_some, pairs.reshape(-1, AT_ONCE)))[: count * len(groups)]
    of_sets = np.moveaxis(found.reshape(count, len(groups), -1, WIDTH), 1, 2)  # (n, C, groups, WIDTH)
    return of_sets.reshape(*of_sets.shape[:2], -1)[..., : len(theta_i)]


@kept()
def _of_many(model: Reflectance, values: Mapping[str, Array], wavelengths_um: Array, theta_i: Array) -> Array:
    """Of pairs of a set and incidences, (N, C, A)."""
    which = {name: x for name, x in values.items() if name == WHICH_BODY}
    moving = {name: x for name, x in values.items() if name not in which}
    return jax.lax.map(
        lambda pair: directional_albedo(model, {**pair[0], **which}, pair[1], wavelengths_um), (moving, theta_i)
    )


def with_slopes(
    material: Reflectance, values: Mapping[str, ArrayLike], bands: Bands, theta_i: np.ndarray
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """TIS of parameters at incidences (rad), (A,): (C, A), and its slopes by parameter, (C, A).

    A channel's depends on no other channel's parameters, so that one slope says what its own do to it. By differences
    within the bounds: a program of the derivatives would take 6 s to compile. They agree with the derivatives of the
    integral within 1e-4 of these plus 3e-4.
    """
    at = {q.name: np.asarray(values[q.name], float) for q in material.parameters}
    ends = {}
    for q in material.parameters:
        x = at[q.name]
        step = STEP * (np.abs(x - q.offset) if q.scale == "log" else np.maximum(np.abs(x), LEAST))
        ends[q.name] = [np.clip(x + s * step, np.minimum(x, q.lower), np.maximum(x, q.upper)) for s in (1, -1)]
    moved = [at, *({**at, name: end} for name, both in ends.items() for end in both)]
    at_fit, *found = of_values(material, {name: np.stack([one[name] for one in moved]) for name in at}, bands, theta_i)
    return at_fit, {
        name: (up - down) / (high - low)[..., None]
        for (name, (high, low)), up, down in zip(ends.items(), found[::2], found[1::2], strict=True)
    }
