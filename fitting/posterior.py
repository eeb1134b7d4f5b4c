"""Posterior of a fitted material by emcee (docs/statistics.md states the likelihood).

Residuals of a measured material are mostly model error, smooth over the grid, not independent noise. Channel c is
therefore taken as N_c independent residuals of unknown scale, N_c estimated from the residuals' own correlation
(``metrics.effective_count``). With Jeffreys' prior the scale integrates out:

    log L = - sum_c N_c / 2 log S_c(z),    S_c the channel's share of Eq. 56.

S_c is summed over a thinned grid, which the smoothness of those residuals allows. The optimum of the thinned grid is
not quite that of all bins, nor is its curvature: the thinned likelihood is evaluated at an affine image of the point
(:class:`Transport`), so that its mode and curvature are those of all bins and only its shape farther out is the thinned
grid's. How far the mode was moved, in posterior standard deviations, is reported as ``thinning_shift``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import emcee
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .residuals import Forward, Problem, compiled_normal_equations, cost
from .transforms import Layout

ENOUGH = 50  # autocorrelation times a chain must span before intervals are given (emcee's recommendation)
CHECK_EVERY = 250  # steps between looks at the autocorrelation time
BURN_IN = 5  # autocorrelation times discarded at the start
STUDENT_DOF = 5.0  # tails of the proposal drawn from the Laplace approximation
NEWTON_STEPS = 5  # to the thinned grid's optimum, each of at most one standard deviation
OPEN = 0.05  # precision added along directions that the likelihood leaves open
BOUND_PRIOR_SD = 3.0  # the logistic prior's standard deviation is pi/sqrt(3); starting spread never exceeds this
TOO_SHORT = (
    "chain too short: {steps} steps are {ratio:.0f} autocorrelation times, {enough} are needed; "
    "raise posterior.max_steps"
)
DONE = "long enough: {steps} steps are {ratio:.0f} autocorrelation times"


@dataclass(frozen=True)
class Posterior:
    """Samples of the posterior and what is known about them.

    Attributes:
        chain: free coordinates, (steps, walkers, P), whole. log_prob: (steps, walkers).
        discard: steps to drop at the start. autocorrelation: integrated time per entry (steps).
        effective_size: independent samples per entry. acceptance: mean fraction of accepted moves.
        sufficient: whether intervals may be given. message: in a sentence.
        thinning_shift: how far thinning moved the optimum, which was undone: the largest entry, in posterior standard
            deviations.
    """

    chain: np.ndarray
    log_prob: np.ndarray
    discard: int
    autocorrelation: np.ndarray
    effective_size: np.ndarray
    acceptance: float
    sufficient: bool
    message: str
    thinning_shift: float

    def values(self, layout: Layout) -> np.ndarray:
        """Physical values of the kept samples, shape (samples, P)."""
        kept = self.chain[self.discard :].reshape(-1, self.chain.shape[-1])
        named = jax.vmap(layout.values)(jnp.asarray(kept))
        return np.concatenate([np.asarray(named[q.name]).reshape(len(kept), -1) for q in layout.parameters], 1)


class Transport(NamedTuple):
    """Affine map from the coordinates of all bins to those of the thinned grid, for which the likelihoods agree."""

    centre: Any  # optimum on all bins, (P,)
    image: Any  # optimum of the thinned likelihood, (P,)
    matrix: Any  # (P, P), symmetric


def laplace_covariance(normal: np.ndarray, counts: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Covariance of the Gaussian approximation in free coordinates, (P, P), at an optimum.

    The curvature of N_c/2 log S_c is N_c H_c / S_c with H_c the channel's Gauss-Newton matrix; the logistic prior adds
    2 u (1 - u). Directions that the data leave open are thus held by the prior, never infinite.

    Args:
        normal: per channel, (C, P+1, P+1). counts: effective sample counts N_c, (C,).
    """
    u = 1 / (1 + np.exp(-z))
    return np.linalg.inv(np.diag(2 * u * (1 - u) + 1e-3) + likelihood_precision(normal, counts))


@partial(jax.jit, static_argnums=0)
def _log_prob(forward: Forward, z: Array, transport: Transport, problem: Problem, counts: Array) -> Array:
    """Log posterior density of walkers ``z`` (W, P), all in one call; -inf where the model is not finite."""

    def one(z: Array) -> Array:
        s = cost(forward, transport.image + transport.matrix @ (z - transport.centre), problem)
        value = forward.layout.log_prior(z) - jnp.sum(counts / 2 * jnp.log(jnp.maximum(s, 1e-30)))
        return jnp.where(jnp.isfinite(value), value, -jnp.inf)

    return jax.vmap(one)(z)


def _from_laplace(z: np.ndarray, covariance: np.ndarray) -> Callable:
    """Independent proposals from a Student t with the Laplace approximation's place and shape, for emcee's MHMove."""
    root = np.linalg.cholesky(covariance)
    size = len(z)

    def log_density(x: np.ndarray) -> np.ndarray:
        whitened = np.linalg.solve(root, (x - z).T)
        return -(STUDENT_DOF + size) / 2 * np.log1p(np.sum(whitened**2, 0) / STUDENT_DOF)

    def propose(coordinates: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        scale = np.sqrt(STUDENT_DOF / rng.chisquare(STUDENT_DOF, len(coordinates)))
        new = z + (root @ rng.standard_normal((size, len(coordinates))) * scale).T
        return new, log_density(coordinates) - log_density(new)

    return propose


def _sufficient(sampler: emcee.EnsembleSampler) -> tuple[np.ndarray, float]:
    """Autocorrelation times, and how many of the longest of them the chain spans after burn-in."""
    times = np.maximum(sampler.get_autocorr_time(tol=0), 1.0)
    times = np.where(np.isfinite(times), times, sampler.iteration)
    return times, float(sampler.iteration / times.max() - BURN_IN)


def sample(
    forward: Forward,
    z: np.ndarray,
    normal: np.ndarray,
    counts: np.ndarray,
    problem: Problem,
    max_steps: int,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Posterior:
    """Run emcee until the chain spans ``ENOUGH`` autocorrelation times or ``max_steps``.

    Args:
        z, normal: optimum on all bins and its normal equations. counts: effective sample counts per channel.
        problem: thinned samples the likelihood is summed over. seed: of walkers and moves.
        progress: called with (steps done, steps at the most).

    Walkers start from the Laplace approximation. Moves: differential evolution with and without snooker, which learn
    the shape from the walkers, and independent proposals from the Laplace approximation.
    """
    covariance = laplace_covariance(normal, counts, z)
    size = len(z)
    walkers = 2 * size + 2 * size % 2
    rng = np.random.default_rng(seed)
    spread = np.minimum(1.0, BOUND_PRIOR_SD / np.sqrt(np.diag(covariance)))
    start = z + rng.multivariate_normal(np.zeros(size), covariance, size=walkers, method="eigh") * spread
    half, weights = walkers // 2, jnp.asarray(counts)
    transport = make_transport(forward, z, normal, counts, problem)
    carried = jax.tree.map(jnp.asarray, transport)

    def log_prob(points: np.ndarray) -> np.ndarray:
        # emcee asks for half of the walkers a move and for all at the start: one compiled shape serves both
        padded = np.concatenate([points, np.repeat(points[:1], -len(points) % half, 0)])
        parts = np.split(padded, len(padded) // half)
        done = [np.asarray(_log_prob(forward, jnp.asarray(p), carried, problem, weights)) for p in parts]
        return np.concatenate(done)[: len(points)]

    moves = [
        (emcee.moves.DEMove(), 0.4),
        (emcee.moves.DESnookerMove(), 0.1),
        (emcee.moves.MHMove(_from_laplace(z, covariance)), 0.5),
    ]
    sampler = emcee.EnsembleSampler(walkers, size, log_prob, vectorize=True, moves=moves)
    sampler.random_state = np.random.RandomState(seed).get_state()
    now: Any = start
    times, ratio = np.full(size, np.inf), 0.0
    while sampler.iteration < max_steps and ratio < ENOUGH:
        for now in sampler.sample(now, iterations=min(CHECK_EVERY, max_steps - sampler.iteration)):  # noqa: B007, B020
            if progress:
                progress(sampler.iteration, max_steps)
        times, ratio = _sufficient(sampler)
    discard = int(min(BURN_IN * times.max(), sampler.iteration // 2))
    said = {"steps": sampler.iteration, "ratio": max(ratio, 0.0), "enough": ENOUGH}
    return Posterior(
        np.asarray(sampler.get_chain()), np.asarray(sampler.get_log_prob()), discard, times,
        (sampler.iteration - discard) * walkers / times,
        float(np.mean(sampler.acceptance_fraction)), ratio >= ENOUGH,
        (DONE if ratio >= ENOUGH else TOO_SHORT).format(**said),
        float(np.max(np.abs(transport.image - z) / np.sqrt(np.diag(covariance)))),
    )  # fmt: skip


def make_transport(
    forward: Forward, z: np.ndarray, normal: np.ndarray, counts: np.ndarray, problem: Problem
) -> Transport:
    """The map that carries the Gaussian approximation on all bins to that of the thinned grid, moving points least.

    The thinned optimum is found by Newton steps of at most one standard deviation; the matrix is that of optimal
    transport between two Gaussians, A = C^(-1/2) (C^(1/2) C_t C^(1/2))^(1/2) C^(-1/2).
    """
    covariance = np.linalg.inv(likelihood_precision(normal, counts) + OPEN * np.eye(len(z)))
    deviation, image, inverse = np.sqrt(np.diag(covariance)), z, covariance
    for _ in range(NEWTON_STEPS):
        thinned = np.asarray(compiled_normal_equations(forward, jnp.asarray(image), problem))
        inverse = np.linalg.inv(likelihood_precision(thinned, counts) + OPEN * np.eye(len(z)))
        gradient = sum(n * m[:-1, -1] / max(m[-1, -1], 1e-30) for m, n in zip(thinned, counts, strict=True))
        step = inverse @ (gradient - OPEN * (image - z))
        image = image + step / max(1.0, np.max(np.abs(step) / deviation))
    root = symmetric_root(covariance)
    back = np.linalg.inv(root)
    matrix = back @ symmetric_root(root @ inverse @ root) @ back
    good = np.isfinite(image).all() and np.isfinite(matrix).all()
    return Transport(z, image, matrix) if good else Transport(z, z, np.eye(len(z)))


def likelihood_precision(normal: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Curvature of sum_c N_c/2 log S_c at an optimum, (P, P): sum_c N_c H_c / S_c, H_c the Gauss-Newton matrix."""
    return np.sum([n * m[:-1, :-1] / max(m[-1, -1], 1e-30) for m, n in zip(normal, counts, strict=True)], axis=0)


def symmetric_root(matrix: np.ndarray) -> np.ndarray:
    """Symmetric square root of a positive definite matrix."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return (vectors * np.sqrt(np.maximum(values, 1e-30))) @ vectors.T
