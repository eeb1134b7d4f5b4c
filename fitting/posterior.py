"""Posterior of a fitted material by emcee (docs/statistics.md states the likelihood).

Residuals of a measured material are mostly model error, smooth over the grid, not independent noise. Channel c is
therefore taken as N_c independent residuals of unknown scale, N_c estimated from the residuals' own correlation
(``metrics.effective_count``). With Jeffreys' prior the scale integrates out:

    log L = - sum_c N_c / 2 log S_c(z),    S_c the channel's share of Eq. 56.

S_c is summed over a thinned grid, which the smoothness of those residuals allows. What thinning does to the likelihood
is measured on draws from the posterior (``thinning_error``); where it is not small, no intervals are given.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import emcee
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .residuals import Forward, Problem, cost
from .transforms import Layout

ENOUGH = 50  # autocorrelation times a chain must span before intervals are given (emcee's recommendation)
CHECK_EVERY = 250  # steps between looks at the autocorrelation time
BURN_IN = 5  # autocorrelation times discarded at the start
CHECKED_DRAWS = 32  # of the posterior, on which the thinned likelihood is compared with that of all bins
THINNING_LIMIT = 1.0  # standard deviation of that difference above which the chain is not the posterior of all bins
BOUND_PRIOR_SD = 3.0  # the logistic prior's standard deviation is pi/sqrt(3); starting spread never exceeds this
TOO_SHORT = (
    "chain too short: {steps} steps are {ratio:.0f} autocorrelation times, {enough} are needed; "
    "raise posterior.max_steps"
)
TOO_THIN = (
    "thinned likelihood too far from that of all bins: their logarithms differ with a standard deviation of {error:.1f}, "
    "at most {limit:.0f} is accepted"
)
DONE = "long enough: {steps} steps are {ratio:.0f} autocorrelation times"


Target = tuple[Forward, Problem]  # model and samples that a likelihood is made of


@dataclass(frozen=True)
class Posterior:
    """Samples of the posterior and what is known about them.

    Attributes:
        chain: free coordinates, (steps, walkers, P), whole. log_prob: (steps, walkers).
        discard: steps to drop at the start. autocorrelation: integrated time per entry (steps).
        effective_size: independent samples per entry. acceptance: mean fraction of accepted moves.
        sufficient: whether intervals may be given. message: in a sentence.
        thinning_error: standard deviation over posterior draws of log L on all bins minus log L on the thinned grid.
    """

    chain: np.ndarray
    log_prob: np.ndarray
    discard: int
    autocorrelation: np.ndarray
    effective_size: np.ndarray
    acceptance: float
    sufficient: bool
    message: str
    thinning_error: float

    def values(self, layout: Layout) -> np.ndarray:
        """Physical values of the kept samples, shape (samples, P)."""
        kept = self.chain[self.discard :].reshape(-1, self.chain.shape[-1])
        named = jax.vmap(layout.values)(jnp.asarray(kept))
        return np.concatenate([np.asarray(named[q.name]).reshape(len(kept), -1) for q in layout.parameters], 1)


def laplace_covariance(normal: np.ndarray, counts: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Covariance of the Gaussian approximation in free coordinates, (P, P), at an optimum.

    The curvature of N_c/2 log S_c is N_c H_c / S_c with H_c the channel's Gauss-Newton matrix; the logistic prior adds
    2 u (1 - u). Directions that the data leave open are thus held by the prior, never infinite.

    Args:
        normal: per channel, (C, P+1, P+1). counts: effective sample counts N_c, (C,).
    """
    u = 1 / (1 + np.exp(-z))
    return np.linalg.inv(np.diag(2 * u * (1 - u) + 1e-3) + likelihood_precision(normal, counts))


def log_likelihood(forward: Forward, z: Array, problem: Problem, counts: Array) -> Array:
    """log L up to a constant, a scalar, at free coordinates ``z`` (P,); counts: effective sample counts N_c, (C,)."""
    return -jnp.sum(counts / 2 * jnp.log(jnp.maximum(cost(forward, z, problem), 1e-30)))


@partial(jax.jit, static_argnums=0)
def _log_prob(forward: Forward, z: Array, problem: Problem, counts: Array) -> Array:
    """Log posterior density of walkers ``z`` (W, P), all in one call; -inf where the model is not finite."""

    def one(z: Array) -> Array:
        value = forward.layout.log_prior(z) + log_likelihood(forward, z, problem, counts)
        return jnp.where(jnp.isfinite(value), value, -jnp.inf)

    return jax.vmap(one)(z)


@partial(jax.jit, static_argnums=0)
def _log_likelihoods(forward: Forward, z: Array, problem: Problem, counts: Array) -> Array:
    """Log likelihood of points (N, P), one after the other."""
    return jax.lax.map(lambda z: log_likelihood(forward, z, problem, counts), z)


def _sufficient(sampler: emcee.EnsembleSampler) -> tuple[np.ndarray, float]:
    """Autocorrelation times, and how many of the longest of them the chain spans after burn-in."""
    times = np.maximum(sampler.get_autocorr_time(tol=0), 1.0)
    times = np.where(np.isfinite(times), times, sampler.iteration)
    return times, float(sampler.iteration / times.max() - BURN_IN)


def sample(
    fitted: Target,
    thinned: Target,
    z: np.ndarray,
    normal: np.ndarray,
    counts: np.ndarray,
    max_steps: int,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Posterior:
    """Run emcee until the chain spans ``ENOUGH`` autocorrelation times or ``max_steps``.

    Args:
        fitted: model and samples that were fitted. thinned: those the likelihood of the chain is computed with.
        z, normal: optimum and its normal equations. counts: effective sample counts per channel.
        seed: of walkers and moves. progress: called with (steps done, steps at the most).

    Walkers start from the Laplace approximation and move by differential evolution, with and without snooker: both
    learn the shape of the posterior from the other walkers and need no tuning.
    """
    covariance = laplace_covariance(normal, counts, z)
    size = len(z)
    walkers = 2 * size
    rng = np.random.default_rng(seed)
    spread = np.minimum(1.0, BOUND_PRIOR_SD / np.sqrt(np.diag(covariance)))
    start = z + rng.multivariate_normal(np.zeros(size), covariance, size=walkers, method="eigh") * spread
    weights = jnp.asarray(counts)

    def log_prob(points: np.ndarray) -> np.ndarray:
        # emcee asks for a quarter, a half or all of the walkers: two compiled shapes serve all
        batch = -(-walkers // 4) if len(points) <= -(-walkers // 4) else size
        padded = np.concatenate([points, np.repeat(points[:1], -len(points) % batch, 0)])
        parts = np.split(padded, len(padded) // batch)
        done = [np.asarray(_log_prob(thinned[0], jnp.asarray(q), thinned[1], weights)) for q in parts]
        return np.concatenate(done)[: len(points)]

    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
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
    chain, said = np.asarray(sampler.get_chain()), {"steps": sampler.iteration, "ratio": max(ratio, 0.0)}
    log_probs = np.asarray(sampler.get_log_prob())
    drawn = rng.choice(len(chain[discard:]) * walkers, CHECKED_DRAWS)
    draws = jnp.asarray(chain[discard:].reshape(-1, size)[drawn])
    thin = log_probs[discard:].reshape(-1)[drawn] - jax.vmap(fitted[0].layout.log_prior)(draws)
    error = float(jnp.std(_log_likelihoods(fitted[0], draws, fitted[1], weights) - thin))
    if ratio < ENOUGH:
        message = TOO_SHORT.format(**said, enough=ENOUGH)
    elif not error < THINNING_LIMIT:
        message = TOO_THIN.format(error=error, limit=THINNING_LIMIT)
    else:
        message = DONE.format(**said)
    return Posterior(
        chain, log_probs, discard, times, (sampler.iteration - discard) * walkers / times,
        float(np.mean(sampler.acceptance_fraction)), ratio >= ENOUGH and error < THINNING_LIMIT, message, error,
    )  # fmt: skip


def likelihood_precision(normal: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Curvature of sum_c N_c/2 log S_c at an optimum, (P, P): sum_c N_c H_c / S_c, H_c the Gauss-Newton matrix."""
    return np.sum([n * m[:-1, :-1] / max(m[-1, -1], 1e-30) for m, n in zip(normal, counts, strict=True)], axis=0)
