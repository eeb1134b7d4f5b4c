"""The stand-in's likelihood interpolated between points where it was computed: its gradient leads the walkers.

Weighted residuals of a channel are smooth functions of the few coordinates that it depends on. Their principal
components over the training points (a proper orthogonal decomposition) are interpolated by cubic radial basis
functions with a quadratic polynomial, of distances that count most where they are curved; the cost is a quadratic form
of them. Walkers are led by its gradient (`hamiltonian.Hamiltonian`) and the stand-in itself accepts or refuses: the
emulator's accuracy only decides how often a step is accepted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..fit.transforms import Layout
from .likelihood import Likelihood

NEGLECTED = 1e-2  # of log L, on average over the training points: components that matter less are left out
MOST, MOST_EVER = 1024, 2048  # points, and where the posterior is too crooked for them (`chain.extend`)
ROUNDED = 1024, 16  # centres and components are filled up with idle ones to multiples of these: few shapes to compile
NUGGET = 1e-9  # on the kernel's diagonal, relative to its largest entry
RIDGE = 1e-3  # of quadratic terms, relative to their number of points, where the directions of curvature are found
# Added to the share of the greatest curvature that a direction has; and what counts as none, of the size of residuals.
STRAIGHT, NO_CURVE = 0.1, 1e-6


def coordinates_of(layout: Layout, z: np.ndarray) -> list[np.ndarray]:
    """For every channel the free coordinates that its prediction depends on."""
    depends = np.abs(np.asarray(layout.slopes(z))) > 0
    found = []
    for k in range(len(layout.channels)):
        where = zip(layout.parameters, layout.slices.values(), strict=True)
        rows = [s.start + (k if q.per_channel else 0) for q, s in where]
        found.append(np.flatnonzero(depends[rows].any(0)))
    return found


@jax.jit
def _tail(x: Array) -> Array:
    """Monomials up to degree two, (N, 1 + d + d (d + 1) / 2)."""
    pairs = [x[:, i] * x[:, j] for i, j in combinations_with_replacement(range(x.shape[1]), 2)]
    return jnp.stack([jnp.ones(len(x)), *x.T, *pairs], 1)


def _rounded(compute: Callable[..., Array], *points: np.ndarray) -> np.ndarray:
    """What a function says of points, which are filled up for it: one program for about as many."""
    more = -len(points[0]) % ROUNDED[0]
    return np.asarray(compute(*(np.pad(x, ((0, more), (0, 0))) for x in points)))[: len(points[0])]


def _stretched(x: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Axes, (d, d), along which points (N, d) lie as far apart as what is known there (N, R) is curved.

    Columns are the eigenvectors of the sum of squares of Hessians, those of a quadratic fit. The square of each one's
    length is its share of the greatest curvature, plus `STRAIGHT`.
    """
    d = x.shape[1]
    terms = _rounded(_tail, x)
    ridge = np.diag(np.where(np.arange(terms.shape[1]) > d, RIDGE * len(x), 0.0))
    fitted = np.linalg.solve(terms.T @ terms + ridge, terms.T @ known)[d + 1 :]
    hessians = np.zeros((known.shape[1], d, d))
    for (i, j), slope in zip(combinations_with_replacement(range(d), 2), fitted, strict=True):
        hessians[:, i, j] += slope
        hessians[:, j, i] += slope
    squares, axes = np.linalg.eigh(np.einsum("rij,rjk->ik", hessians, hessians))
    curvature = np.sqrt(np.maximum(squares, 0.0))
    most = max(curvature.max(), NO_CURVE * np.sqrt(np.mean(np.sum(known**2, 1))), 1e-300)
    return axes * np.sqrt(curvature / most + STRAIGHT)


@jax.jit
def _kernel(x: Array, centres: Array) -> Array:
    """Cubes of distances, (N, M)."""
    squares = jnp.sum(x * x, 1)[:, None] + jnp.sum(centres * centres, 1) - 2 * x @ centres.T
    apart = squares > 0  # at a centre itself the root has no slope
    return jnp.where(apart, squares * jnp.sqrt(jnp.where(apart, squares, 1.0)), 0.0)


class Channels(NamedTuple):
    """What is interpolated of each channel, and how residuals count that parameters could undo (P, P)."""

    each: list[dict[str, Array]]
    excess: Array


def cost_at(points: Array, channels: Channels) -> Array:
    """The cost of the residuals of all channels at points (N, P): (N,)."""
    total, undone = jnp.zeros(len(points)), jnp.zeros((len(points), len(channels.excess)))
    for c in channels.each:
        x = (points[:, c["own"]] - c["middle"]) @ c["whiten"]
        components = _kernel(x, c["centres"]) @ c["weights"] + _tail(x) @ c["polynomial"]
        total += jnp.sum(components**2 + 2 * components * c["mean"], 1) + c["constant"]
        undone += components @ c["along"] + c["offset"]
    return total + jnp.sum(undone @ channels.excess * undone, 1)


@jax.jit
def log_posterior(points: Array, channels: Channels, scale: Array | float) -> Array:
    """As emulated, of points (N, P), up to a constant: (N,). scale: of the stand-in."""
    return -scale * cost_at(points, channels) - jnp.sum(points * points, -1) / 2


@dataclass(frozen=True)
class Emulator:
    """The likelihood of a stand-in, interpolated.

    Attributes:
        points: where it was computed, (N, P). residuals: weighted, (N, C, M). own: coordinates of every channel.
        scale: of the stand-in. along, excess: of it, (C, M, P) and (P, P).
    """

    points: np.ndarray
    residuals: np.ndarray
    own: Sequence[np.ndarray]
    scale: float
    along: np.ndarray
    excess: np.ndarray

    @classmethod
    def of(cls, few: Likelihood, layout: Layout, points: np.ndarray) -> "Emulator":
        """From the stand-in at ``points`` (N, P), those where it is not finite left out."""
        own = coordinates_of(layout, points[0])
        along = few.along.reshape(len(own), -1, few.along.shape[1])
        found = cls(points[:0], np.empty((0, *along.shape[:2])), own, few.scale, along, few.excess)
        return found.with_points(few, points, MOST_EVER)

    def with_points(self, few: Likelihood, points: np.ndarray, most: int = MOST) -> "Emulator":
        """The same with more points, the oldest forgotten beyond so many; twice the same counts once."""
        residuals = (few.weighed(points) - few.target).reshape(len(points), len(self.own), -1)
        points = np.concatenate([self.points, points])[-most:]
        residuals = np.concatenate([self.residuals, residuals])[-most:]
        _, first = np.unique(points, axis=0, return_index=True)
        first = np.sort(first[np.isfinite(residuals[first]).all((1, 2))])
        return replace(self, points=points[first], residuals=residuals[first])

    @cached_property
    def channels(self) -> Channels:
        """What :func:`cost_at` needs."""
        found, (squares, axes) = [], np.linalg.eigh(self.excess)
        root = axes * np.sqrt(np.maximum(squares, 0.0))
        for k, own in enumerate(self.own):
            given = self.points[:, own]
            middle, spread = given.mean(0), np.atleast_2d(np.cov(given.T))
            whiten = np.linalg.inv(np.linalg.cholesky(spread + 1e-9 * np.diag(np.diag(spread)))).T
            x = (given - middle) @ whiten
            mean = self.residuals[:, k].mean(0)
            left, size, basis = np.linalg.svd(self.residuals[:, k] - mean, full_matrices=False)
            weight = basis @ self.along[k] @ root
            matters = size**2 * (1 + np.sum(weight**2, 1))
            rest = np.append(np.cumsum(matters[::-1])[::-1], 0.0) * self.scale / len(x)
            rank = max(int(np.argmax(rest < NEGLECTED)), 1)
            parts = left[:, :rank] * size[:rank]
            stretch = _stretched(x, parts)
            whiten, x = whiten @ stretch, x @ stretch
            tail, kernel = _rounded(_tail, x), _rounded(_kernel, x, x)[:, : len(x)]
            system = np.block([[kernel, tail], [tail.T, np.zeros((tail.shape[1],) * 2)]])
            system[np.diag_indices(len(x))] += NUGGET * kernel.max()
            known = np.concatenate([parts, np.zeros((tail.shape[1], rank))])
            solved = np.linalg.solve(system, known)
            more, wider = -len(x) % ROUNDED[0], -rank % ROUNDED[1]
            found.append({
                "own": own, "middle": middle, "whiten": whiten, "centres": np.pad(x, ((0, more), (0, 0))),
                "weights": np.pad(solved[: len(x)], ((0, more), (0, wider))),
                "polynomial": np.pad(solved[len(x) :], ((0, 0), (0, wider))),
                "mean": np.pad(basis[:rank] @ mean, (0, wider)), "constant": mean @ mean,
                "along": np.pad(basis[:rank] @ self.along[k], ((0, wider), (0, 0))), "offset": mean @ self.along[k],
            })  # fmt: skip
        return jax.device_put(Channels(found, jnp.asarray(self.excess)))
