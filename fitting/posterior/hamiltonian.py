"""Moves of the chain that the emulator leads: Hamiltonian Monte Carlo on the emulated posterior, as proposals.

docs/statistics.md says what they gain; tests/fitting/test_posterior.py that they leave the target as it is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .emulator import Channels, Emulator, log_posterior

TRAJECTORIES = 3  # of a led move, one after the other
LENGTHS = 1.0, 2.5  # how far each goes, in standard deviations of the covariance behind `root`
STEP_SIZES = 0.03, 0.15, 0.8  # of leaps: least, to begin with, most
UNEVEN = 0.5  # how much shorter some of them are
RATE = 0.8  # share of trajectories to be accepted: where fewer are, leaps are made shorter (Hoffman & Gelman 2014)
SOFTENED = 1 / 0.9  # temperature of the emulated likelihood: where the emulator is too low, walkers get away sooner


class Chances(NamedTuple):
    """What is random of a led move of T trajectories: momenta (T, W, P), logarithms of uniform numbers (T, W), leaps
    and their lengths (T,).
    """

    momenta: Array
    thresholds: Array
    leaps: Array
    lengths: Array


Density = Callable[[Array], Array]


def leapfrog(
    log_density: Density, root: Array, points: Array, momenta: Array, leaps: Array, length: Array
) -> tuple[Array, Array]:
    """So many leaps by Hamilton's equations: points and momenta at their end, (W, P) each."""
    slope = jax.grad(lambda z: jnp.sum(log_density(z)))

    def leap(_: Array | int, at: tuple[Array, Array]) -> tuple[Array, Array]:
        z, p = at
        z = z + length * p @ root.T
        return z, p + length * slope(z) @ root

    z, p = jax.lax.fori_loop(0, leaps, leap, (points, momenta + length / 2 * slope(points) @ root))
    return z, p - length / 2 * slope(z) @ root


@jax.jit
def _lead(points: Array, chances: Chances, root: Array, channels: Channels, scale: Array) -> tuple[Array, Array, Array]:
    """Where Hamiltonian Monte Carlo on the emulated log posterior leads, how much lower that is there, and the share of
    trajectories that were accepted: (W, P), (W,) and ().
    """
    log_density = partial(log_posterior, channels=channels, scale=scale)

    def trajectory(at: tuple[Array, Array], chance: Chances) -> tuple[tuple[Array, Array], Array]:
        z, held = at
        new, turned = leapfrog(log_density, root, z, chance.momenta, chance.leaps, chance.lengths)
        found = log_density(new)
        kinetic = jnp.sum(chance.momenta**2 - turned**2, -1) / 2
        # false where all is nan: a walker that left the model's domain stays
        accepted = found - held + kinetic > chance.thresholds
        return (jnp.where(accepted[:, None], new, z), jnp.where(accepted, found, held)), jnp.mean(accepted)

    start = log_density(points)
    (end, found), rates = jax.lax.scan(trajectory, (points, start), chances)
    return end, start - found, jnp.mean(rates)


@dataclass(frozen=True)
class Hamiltonian:
    """Proposals for emcee's MHMove: where Hamiltonian Monte Carlo on the emulated posterior leads.

    A few moves of one kind, which leave the emulated posterior pi*, its likelihood softened, as it is and are
    reversible, make one proposal, its ratio of probabilities there and back being pi*(x)/pi*(y): with it the posterior
    of the stand-in is left as it is, however rough the emulator (surrogate transitions, Liu 2001, section 9.4.3;
    Hamiltonian moves: Neal 2011).

    Attributes:
        emulator: of the posterior. root: of a covariance of walkers, (P, P), which takes the place of a mass.
        leap: the longest, in standard deviations of that covariance. temperature: of the stand-in's likelihood.
    """

    emulator: Emulator
    root: np.ndarray
    leap: float
    temperature: float = 1.0

    def __call__(self, points: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        """New points, and the logarithm of the proposals' ratio; (W, P) and (W,)."""
        new, log_ratio, _ = self._go(points, rng)
        return new, np.where(np.isfinite(log_ratio), log_ratio, -np.inf)

    def _go(self, points: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray, float]:
        momenta = rng.standard_normal((TRAJECTORIES, *points.shape))
        thresholds = np.log(rng.uniform(size=(TRAJECTORIES, len(points))))
        lengths = self.leap * rng.uniform(UNEVEN, 1, size=TRAJECTORIES)
        leaps = np.ceil(rng.uniform(*LENGTHS, size=TRAJECTORIES) / lengths).astype(int)
        chances = Chances(*jax.device_put((momenta, thresholds, leaps, lengths)))
        scale = self.emulator.scale / (SOFTENED * self.temperature)
        found = _lead(points, chances, self.root, self.emulator.channels, scale)
        return np.asarray(found[0]), np.asarray(found[1]), float(found[2])

    def fitting_leap(self, points: np.ndarray, seed: int) -> float:
        """Longer or shorter leaps, as more or fewer trajectories from ``points`` (W, P) are accepted than are to be."""
        rate = self._go(points, np.random.RandomState(seed))[2]
        return float(np.clip(self.leap * np.exp(2 * (rate - RATE)), STEP_SIZES[0], STEP_SIZES[2]))
