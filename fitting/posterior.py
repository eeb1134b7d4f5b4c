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

import emcee
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import log_ndtr
from scipy.special import expit, ndtri
from scipy.stats import chi2

from ..model.effects import Effects
from .laplace import laplace_covariance
from .problem import Problem
from .residuals import cost
from .transforms import Layout

ENOUGH = 50  # autocorrelation times a chain must span before intervals are given (emcee's recommendation)
CHECK_EVERY = 250  # steps between looks at the autocorrelation time
STEADY = 0.1  # relative change of that time between two looks: a short chain sees too short a time
TUNING = (400, 400, 700)  # steps of the stages of tuning, discarded
INDEPENDENT = 0.6  # share of independent proposals after tuning
STUDENT_DOF = 10.0  # tails of the independent proposals
CHECKED_DRAWS = 32  # of the posterior, on which the thinned likelihood is compared with that of all bins
THINNING_LIMIT = 1.0  # standard deviation of that difference above which the chain is not the posterior of all bins
BOUND_PRIOR_SD = 3.0  # the logistic prior's standard deviation is pi/sqrt(3); starting spread never exceeds this
TOO_SHORT = (
    "chain too short: {steps} steps are {ratio:.0f} autocorrelation times, {enough} are needed; "
    "raise posterior.max_steps"
)
UNSTEADY = "chain too short: after {steps} steps its autocorrelation time still changes; raise posterior.max_steps"
TOO_THIN = (
    "thinned likelihood too far from that of all bins: their logarithms differ with a standard deviation of "
    "{error:.1f}, at most {limit:.0f} is accepted"
)
DONE = "long enough: {steps} steps are {ratio:.0f} autocorrelation times"


Target = tuple[Effects, Problem]  # model and samples that a likelihood is made of


@dataclass(frozen=True)
class Posterior:
    """Samples of the posterior and what is known about them.

    Attributes:
        chain: free coordinates, (steps, walkers, P), without those of tuning. log_prob: (steps, walkers).
        autocorrelation: integrated time per entry (steps).
        effective_size: independent samples per entry. acceptance: mean fraction of accepted moves.
        sufficient: whether intervals may be given. message: in a sentence.
        thinning_error: standard deviation over posterior draws of log L on all bins minus log L on the thinned grid.
    """

    chain: np.ndarray
    log_prob: np.ndarray
    autocorrelation: np.ndarray
    effective_size: np.ndarray
    acceptance: float
    sufficient: bool
    message: str
    thinning_error: float

    def values(self, layout: Layout) -> np.ndarray:
        """Physical values of the kept samples, shape (samples, P)."""
        kept = jnp.asarray(self.chain.reshape(-1, self.chain.shape[-1]))
        named = jax.vmap(layout.values)(kept)
        return np.concatenate([np.asarray(named[q.name]).reshape(len(kept), -1) for q in layout.parameters], 1)


def log_likelihood(effects: Effects, z: Array, problem: Problem, counts: Array) -> Array:
    """log L up to a constant, a scalar, at free coordinates ``z`` (P,); counts: effective sample counts N_c, (C,)."""
    return -jnp.sum(counts / 2 * jnp.log(jnp.maximum(cost(effects, z, problem), 1e-30)))


def free_of_normal(x: Array) -> Array:
    """z = logit(Phi(x)), the free coordinates of those that are sampled, in which every prior is standard normal.

    The logistic tails of z, towards a bound or where the data leave a parameter open, would fit no elliptical proposal.
    """
    return log_ndtr(x) - log_ndtr(-x)


def normal_of_free(z: np.ndarray) -> np.ndarray:
    """Inverse of :func:`free_of_normal`."""
    return np.where(z < 0, ndtri(expit(z)), -ndtri(expit(-z)))


@partial(jax.jit, static_argnums=0)
def _log_prob(effects: Effects, x: Array, problem: Problem, counts: Array) -> Array:
    """Log posterior density of walkers ``x`` (W, P), all in one call; -inf where the model is not finite."""

    def one(x: Array) -> Array:
        value = log_likelihood(effects, free_of_normal(x), problem, counts) - jnp.sum(x * x) / 2
        return jnp.where(jnp.isfinite(value), value, -jnp.inf)

    # under vmap both sides of the table's fallback would be computed
    return jax.lax.map(one, x) if effects.diffraction == "scaled" else jax.vmap(one)(x)


def independent_proposal(samples: np.ndarray, log_prob: np.ndarray) -> Callable:
    """Independent proposals for emcee's MHMove from a Student t with place and shape of ``samples`` (N, P).

    The shape is that of the likelier half of the samples, for walkers astray must not widen it; its scale makes the
    median distance of all samples that of a normal distribution.
    """
    core = samples[log_prob >= np.median(log_prob)]
    centre, size = core.mean(0), samples.shape[1]
    shape = np.cov(core.T)
    shape += 1e-9 * np.diag(np.diag(shape))
    distance = np.sum((samples - centre) * np.linalg.solve(shape, (samples - centre).T).T, 1)
    root = np.linalg.cholesky(shape * np.median(distance) / chi2(size).ppf(0.5))
    inverse = np.linalg.inv(root)  # a triangular solve wakes OpenBLAS's threads, which then contend with XLA's

    def log_density(x: np.ndarray) -> np.ndarray:
        whitened = (x - centre) @ inverse.T
        return -(STUDENT_DOF + size) / 2 * np.log1p(np.sum(whitened**2, 1) / STUDENT_DOF)

    def propose(coordinates: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        scale = np.sqrt(STUDENT_DOF / rng.chisquare(STUDENT_DOF, len(coordinates)))
        new = centre + (root @ rng.standard_normal((size, len(coordinates))) * scale).T
        return new, log_density(coordinates) - log_density(new)

    return propose


@dataclass(frozen=True)
class _Ensemble:
    """What every stage of sampling shares: the likelihood of the walkers, and their number.

    Attributes:
        target: model and samples of the likelihood. counts: effective sample counts (C,). size: parameters P.
    """

    target: Target
    counts: Array
    size: int

    @property
    def walkers(self) -> int:
        """Twice as many as parameters."""
        return 2 * self.size

    def log_prob(self, points: np.ndarray) -> np.ndarray:
        """Log posterior density of points (N, P).

        emcee asks for a quarter, a half or all of the walkers: two compiled shapes serve all. All of them at once would
        be slower than two halves, whose intermediates stay in the cache (measured at order 16).
        """
        quarter = -(-self.walkers // 4)
        batch = quarter if len(points) <= quarter else self.size
        padded = np.concatenate([points, np.repeat(points[:1], -len(points) % batch, 0)])
        parts = np.split(padded, len(padded) // batch)
        effects, problem = self.target
        done = [np.asarray(_log_prob(effects, jnp.asarray(q), problem, self.counts)) for q in parts]
        return np.concatenate(done)[: len(points)]

    def sampler(self, proposal: Callable | None, share: float, seed: int) -> emcee.EnsembleSampler:
        """Differential evolution, with and without snooker, and a ``share`` of independent proposals, if any."""
        share = share if proposal else 0.0
        moves = [(emcee.moves.DEMove(), 0.75 * (1 - share)), (emcee.moves.DESnookerMove(), 0.25 * (1 - share))]
        independent = [(emcee.moves.MHMove(proposal), share)] if proposal else []
        made = emcee.EnsembleSampler(
            self.walkers, self.size, self.log_prob, vectorize=True, moves=moves + independent
        )  # fmt: skip
        made.random_state = np.random.RandomState(seed).get_state()
        return made


def _advance(
    sampler: emcee.EnsembleSampler, now: np.ndarray, steps: int, progress: Callable[[int], None]
) -> np.ndarray:
    """Walkers after so many more steps."""
    for _ in sampler.sample(now, iterations=steps):
        progress(sampler.iteration)
    return np.asarray(sampler.get_last_sample().coords)


def _tune(
    ensemble: _Ensemble, now: np.ndarray, stages: list[int], seed: int, progress: Callable[[int], None]
) -> tuple[np.ndarray, Callable]:
    """Walkers after tuning, whose steps are not kept, and the independent proposals learnt from it.

    After each stage proposals of the shape found so far join in; of the first, half is the way there.
    """
    proposal, before = None, 0
    for stage, steps in enumerate(stages):
        sampler = ensemble.sampler(proposal, INDEPENDENT / 2, seed + 1 + stage)
        now = _advance(sampler, now, steps, lambda done, before=before: progress(before + done))
        before += steps
        arrived = 0 if stage else steps // 2
        seen, log_probs = (np.asarray(x)[arrived:] for x in (sampler.get_chain(), sampler.get_log_prob()))
        proposal = independent_proposal(seen.reshape(-1, ensemble.size), log_probs.ravel())
    assert proposal is not None  # there is at least one stage
    return now, proposal


def _extend(
    sampler: emcee.EnsembleSampler, now: np.ndarray, max_steps: int, progress: Callable[[int], None]
) -> tuple[np.ndarray, float, bool]:
    """Sample until long enough; autocorrelation times (P,), steps in the longest of them, whether that is steady."""
    times, ratio, steady = np.full(now.shape[1], np.inf), 0.0, False
    while sampler.iteration < max_steps and not (ratio >= ENOUGH and steady):
        now = _advance(sampler, now, min(CHECK_EVERY, max_steps - sampler.iteration), progress)
        last, times = times.max(), np.maximum(sampler.get_autocorr_time(tol=0), 1.0)
        times = np.where(np.isfinite(times), times, sampler.iteration)
        ratio, steady = float(sampler.iteration / times.max()), bool(abs(times.max() - last) < STEADY * times.max())
    return times, ratio, steady


def thinning_error(fitted: Target, thinned: Target, draws: np.ndarray, counts: Array) -> float:
    """Standard deviation, over ``draws`` (N, P), of log L on all bins minus log L on the thinned grid."""
    thin, whole = (
        np.array([log_likelihood(model, jnp.asarray(z), samples, counts) for z in draws])
        for model, samples in (thinned, fitted)
    )
    return float(np.std(whole - thin))


def _verdict(steps: int, ratio: float, steady: bool, error: float) -> tuple[bool, str]:
    """Whether intervals may be given, and why or why not."""
    if ratio < ENOUGH:
        return False, TOO_SHORT.format(steps=steps, ratio=ratio, enough=ENOUGH)
    if not steady:
        return False, UNSTEADY.format(steps=steps)
    if not error < THINNING_LIMIT:
        return False, TOO_THIN.format(error=error, limit=THINNING_LIMIT)
    return True, DONE.format(steps=steps, ratio=ratio)


def sample(
    fitted: Target,
    thinned: Target,
    z: np.ndarray,
    normal: np.ndarray,
    counts: np.ndarray,
    max_steps: int,
    seed: int,
    progress: Callable[[int, int], None] = lambda done, most: None,
) -> Posterior:
    """Run emcee until the chain spans ``ENOUGH`` autocorrelation times or ``max_steps``.

    Args:
        fitted: model and samples that were fitted. thinned: those the likelihood of the chain is computed with.
        z, normal: optimum and its normal equations. counts: effective sample counts per channel.
        seed: of walkers and moves. progress: called with (steps done, steps at the most).

    Walkers start from the Laplace approximation.
    """
    ensemble = _Ensemble(thinned, jnp.asarray(counts), len(z))
    rng = np.random.default_rng(seed)
    covariance = laplace_covariance(normal, counts, z)
    spread = np.minimum(1.0, BOUND_PRIOR_SD / np.sqrt(np.diag(covariance)))
    away = rng.multivariate_normal(np.zeros(len(z)), covariance, size=ensemble.walkers, method="eigh") * spread
    stages = [min(steps, max_steps) for steps in TUNING]
    tuned, most = sum(stages), sum(stages) + max_steps
    now, proposal = _tune(ensemble, normal_of_free(z + away), stages, seed, lambda done: progress(done, most))
    sampler = ensemble.sampler(proposal, INDEPENDENT, seed)
    times, ratio, steady = _extend(sampler, now, max_steps, lambda done: progress(tuned + done, most))
    chain = np.asarray(free_of_normal(jnp.asarray(sampler.get_chain())))
    log_prob = np.asarray(sampler.get_log_prob())
    drawn = chain.reshape(-1, len(z))[rng.choice(log_prob.size, CHECKED_DRAWS)]
    error = thinning_error(fitted, thinned, drawn, ensemble.counts)
    sufficient, message = _verdict(sampler.iteration, ratio, steady, error)
    acceptance = float(np.mean(sampler.acceptance_fraction))
    return Posterior(chain, log_prob, times, log_prob.size / times, acceptance, sufficient, message, error)
