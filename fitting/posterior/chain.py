"""The chain of the posterior: emcee on the stand-in of the likelihood, led by an emulator of it.

docs/statistics.md states the likelihood and what is asked of a chain before intervals are given; `importance` corrects
it to the likelihood of all data.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import emcee
import numpy as np

from ...merl_io.archive import arrays
from ...merl_io.atomic import write_atomically
from ...merl_io.source import MerlError, opened
from ..fit.transforms import Layout
from .diagnosis import diagnose
from .emulator import MOST_EVER, Emulator, log_posterior
from .hamiltonian import STEP_SIZES, Hamiltonian
from .likelihood import Likelihood

WALKERS = 32  # or two for each parameter, which differential evolution needs
CHECK_EVERY = 100  # steps after which the chain is kept, and looked at
GROWTH = 0.1  # of a long chain, since the last look, before the next: a look at 6000 steps takes 5 s
FIRST, ROUND = 120, 25  # steps of tuning, discarded: before the emulator, and of each round of training
# Of the stand-in's likelihood, whose power is 1/temperature, in each of these rounds; the first also before the
# emulator. The last must be 1: there the chain begins. Where the emulator is too low walkers get stuck, or never come.
TEMPERATURES = 4.0, 4.0, 3.0, 2.0, 1.0
# The emulator is trained anew if it is too low by more than TOO_LOW (log posterior) at over a share RARE of states.
TOO_LOW, RARE = 1.0, 0.01
RETRAININGS = 5  # at the most: looks after which it is trained where it was too low, and the chain begins anew
TRAINING_POINTS, MORE = 700, 200  # of the emulator: from the first steps, and from each round
EARLY = 1 / 6  # of the most steps: a chain that has made more of them does not begin anew
DEPTH = 25.0  # of (tempered) log posterior below the highest: deeper points tell the emulator nothing that matters
HMC_SHARE = 0.8  # share of moves that are led; the others are differential evolution
KEYS = 624  # of a Mersenne twister
STATE = (  # arrays of a chain
    "chain_free", "log_prob", "accepted", "root", "leap", "training_points", "fit_free", "random_keys", "random_state",
    "retrainings",
)  # fmt: skip
GOLDEN = (np.sqrt(5) - 1) / 2
LogProb = Callable[[np.ndarray], np.ndarray]
Progress = Callable[[int, int], None]


class ChainError(MerlError):
    """A file that is not the chain of this fit; the message is one line that names it."""


@dataclass(frozen=True)
class Chain:
    """Steps of the walkers after tuning, and what goes on from there.

    Attributes:
        states: free coordinates, (steps, walkers, P). log_prob: (steps, walkers). accepted: moves, in all.
        root, leap: of `Hamiltonian`, as tuned. training_points: of the emulator, (N, P).
        random: keys, position, whether there is a cached normal number, and that.
        fit: free coordinates of the fit that it belongs to, (P,).
        retrainings: how often the emulator may still be trained anew, and the chain begin again.
    """

    states: np.ndarray
    log_prob: np.ndarray
    accepted: float
    root: np.ndarray
    leap: float
    training_points: np.ndarray
    random: tuple[np.ndarray, int, int, float]
    fit: np.ndarray
    retrainings: int = 0

    @property
    def acceptance(self) -> float:
        """Mean fraction of accepted moves."""
        return self.accepted / max(self.log_prob.size, 1)

    def arrays(self) -> dict[str, np.ndarray]:
        """What goes into a file; :func:`read_chain` makes a chain of it again."""
        keys, position, cached, normal = self.random
        return {
            "chain_free": self.states, "log_prob": self.log_prob, "accepted": np.array(self.accepted),
            "root": self.root, "leap": np.array(self.leap), "fit_free": self.fit, "random_keys": keys,
            "random_state": np.array([position, cached, normal]),
            "training_points": self.training_points, "retrainings": np.array(self.retrainings),
        }  # fmt: skip


def read_chain(path: Path, fit: np.ndarray) -> Chain:
    """The chain in a file.

    Args:
        fit: free coordinates of the fit that it should be of.

    Raises:
        ChainError: missing, damaged, or of another fit.
    """
    try:
        with opened(path, ChainError) as (file, _):
            found = arrays(file, lambda name: name in STATE)
        theirs = _array(found, "fit_free", None)
        size = len(theirs)
        states = _array(found, "chain_free", None, None, size)
        position, cached, normal = _array(found, "random_state", 3)
        random = (_array(found, "random_keys", KEYS), int(position), int(cached), float(normal))
        chain = Chain(
            states, _array(found, "log_prob", *states.shape[:2]), float(_array(found, "accepted")),
            _array(found, "root", size, size), float(_array(found, "leap")),
            _array(found, "training_points", None, size), random, theirs, int(_array(found, "retrainings")),
        )  # fmt: skip
    except ChainError:
        raise
    except (ValueError, KeyError):
        raise ChainError(
            f"{path}: cannot be continued (it is damaged, or no chain); delete it to start a new chain"
        ) from None
    if chain.fit.shape != fit.shape or not np.allclose(chain.fit, fit, atol=1e-6):
        raise ChainError(f"{path}: is the chain of another fit; delete it to start a new chain")
    return chain


def _array(arrays: dict[str, np.ndarray], name: str, *shape: int | None) -> np.ndarray:
    """Finite numbers of this shape, None for any size."""
    array = arrays[name]
    if array.ndim != len(shape) or any(size not in (None, at) for size, at in zip(shape, array.shape, strict=True)):
        raise ValueError(name)
    if not np.isfinite(array[array != -np.inf] if name == "log_prob" else array).all():
        raise ValueError(name)
    return array


def write_chain(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write atomically (npz, no pickles)."""
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))  # pyright: ignore[reportArgumentType] - none is called allow_pickle


Moves = list[tuple[emcee.moves.Move, float]]
EVOLUTION: Moves = [(emcee.moves.DEMove(), 0.6), (emcee.moves.DESnookerMove(), 0.4)]


def _moves(lead: Hamiltonian) -> Moves:
    """Led moves and differential evolution, which crosses what divides two modes."""
    return [(emcee.moves.MHMove(lead), HMC_SHARE), *((move, share * (1 - HMC_SHARE)) for move, share in EVOLUTION)]


class _Walked(NamedTuple):
    """Where walkers went: states (steps, W, P), log_prob (steps, W), moves that were accepted, and where they are."""

    states: np.ndarray
    log_prob: np.ndarray
    accepted: float
    now: Any  # emcee.State; emcee has no types


def _advance(
    log_prob: LogProb, moves: Moves, now: emcee.State, steps: int, progress: Progress, done: int = 0, most: int = 0
) -> _Walked:
    """So many steps; ``done`` before them, of ``most``: for ``progress``."""
    walkers, size = now.coords.shape
    sampler = emcee.EnsembleSampler(walkers, size, log_prob, vectorize=True, moves=moves)
    sampler.log_prob_fn = log_prob  # pyright: ignore[reportAttributeAccessIssue] - emcee's wrapper prints all walkers at Ctrl-C
    for _ in sampler.sample(now, iterations=steps):
        progress(done + sampler.iteration, most)
    states, found = np.asarray(sampler.get_chain()), np.asarray(sampler.get_log_prob())
    return _Walked(states, found, float(np.sum(sampler.acceptance_fraction)) * steps, sampler.get_last_sample())


def spread_over(total: int, count: int, begun: int = 0) -> np.ndarray:
    """Places ``begun`` to ``count`` of a sequence that covers 0 .. total - 1 evenly however long it is."""
    return np.minimum(((np.arange(begun, count) + 0.5) * GOLDEN % 1.0 * total).astype(int), total - 1)


class _Recorder:
    """The log posterior of a stand-in, its likelihood tempered, which remembers what it was asked."""

    def __init__(self, few: Likelihood, temperature: float) -> None:
        self.few = replace(few, scale=few.scale / temperature)
        self.points: list[np.ndarray] = []
        self.found: list[np.ndarray] = []

    def __call__(self, points: np.ndarray) -> np.ndarray:
        found = self.few.log_posterior(points)
        self.points.append(points.copy())
        self.found.append(found)
        return found

    def asked(self, count: int) -> np.ndarray:
        """So many points, accepted or not; none that are far below the highest."""
        points, found = np.concatenate(self.points), np.concatenate(self.found)
        high = points[found > found.max() - DEPTH]
        return high[spread_over(len(high), min(count, len(high)))]


def begin(
    few: Likelihood, layout: Layout, fit: np.ndarray, covariance: np.ndarray, seed: int, progress: Progress
) -> tuple[Chain, Emulator]:
    """A chain with walkers in place, and the emulator that leads them.

    From the Laplace approximation the walkers go by differential evolution, then in rounds led by an emulator, which
    learns from each: from moves that were refused, above all, for there it erred. They go farther than the posterior
    does, and return to it (`TEMPERATURES`).
    """
    rng, recorder = np.random.default_rng(seed), _Recorder(few, TEMPERATURES[0])
    walkers = max(WALKERS, 2 * len(fit))
    away = rng.multivariate_normal(np.zeros(len(fit)), covariance, size=walkers, method="eigh")
    now = emcee.State(fit + away, random_state=np.random.RandomState(seed).get_state())
    walked = _advance(recorder, EVOLUTION, now, FIRST, progress)
    seen = walked.states[FIRST // 2 :].reshape(-1, len(fit))
    emulator = Emulator.of(few, layout, recorder.asked(TRAINING_POINTS))
    leap = STEP_SIZES[1]
    for k, temperature in enumerate(TEMPERATURES):
        recorder, lead = _Recorder(few, temperature), Hamiltonian(emulator, _root(seen), leap, temperature)
        now = emcee.State(
            walked.now.coords, random_state=walked.now.random_state
        )  # its log_prob is of another temperature
        walked = _advance(recorder, _moves(lead), now, ROUND, progress, FIRST + k * ROUND)
        seen = np.concatenate([seen[len(seen) // 3 :], walked.states.reshape(-1, len(fit))])
        leap = lead.fitting_leap(walked.now.coords, seed)
        # also where walkers are: one where the emulator is too low would not be let go
        emulator = emulator.with_points(few, np.concatenate([recorder.asked(MORE), walked.now.coords]))
    chain = Chain(
        walked.states[-1:], walked.log_prob[-1:], 0.0, _root(seen), leap, emulator.points,
        tuple(walked.now.random_state[1:]), fit, RETRAININGS,
    )  # fmt: skip
    return chain, Emulator.of(few, layout, chain.training_points)  # to the last bit what `extend` has from a file


def _ignored(emulator: Emulator, walked: _Walked) -> tuple[float, np.ndarray]:
    """By how much the emulated log posterior is too low where walkers went, but for the few where it is most so.

    And where that is, `MORE` points.
    """
    states = walked.states.reshape(-1, walked.states.shape[-1])
    emulated = log_posterior(states, emulator.channels, emulator.scale)
    excess = walked.log_prob.ravel() - np.asarray(emulated)
    worst = states[np.argsort(excess)[::-1]]
    _, first = np.unique(worst, axis=0, return_index=True)  # a walker that stayed counts once
    return float(np.quantile(excess - np.median(excess), 1 - RARE)), worst[np.sort(first)[:MORE]]


def _root(states: np.ndarray) -> np.ndarray:
    """Cholesky root of the covariance of states (N, P), lower triangular."""
    covariance = np.atleast_2d(np.cov(states.T))
    return np.linalg.cholesky(covariance + 1e-9 * np.diag(np.diag(covariance)))


def extend(
    chain: Chain, few: Likelihood, layout: Layout, emulator: Emulator, max_steps: int, progress: Progress,
    keep: Callable[[Chain], None], least: int = 0,
) -> Chain:  # fmt: skip
    """Go on until the chain is good enough (`diagnosis`) and has ``least`` steps, or to ``max_steps``.

    Where a chain is slow since walkers came to where the emulator is too low, it is trained with points from there,
    and the chain begins anew. A chain that is kept, read from its file and extended to as many steps is the same to
    the last bit as one that goes on at once.

    Args:
        max_steps: at the most, in all; those given up for retrainings come on top, at most `EARLY` of them for each.
        progress: called with (steps done, steps at the most). keep: called with the chain whenever it has gone on.
    """
    found = diagnose(chain.states)
    while len(chain.states) < max_steps and (found.failures() or len(chain.states) < least):
        done = len(chain.states)
        now = emcee.State(chain.states[-1], log_prob=chain.log_prob[-1], random_state=("MT19937", *chain.random))
        lead = Hamiltonian(emulator, chain.root, chain.leap)
        steps = min(CHECK_EVERY, max_steps - done)
        walked = _advance(few.log_posterior, _moves(lead), now, steps, progress, done, max_steps)
        random = tuple(walked.now.random_state[1:])
        chain = replace(
            chain,
            states=np.concatenate([chain.states, walked.states]),
            log_prob=np.concatenate([chain.log_prob, walked.log_prob]),
            accepted=chain.accepted + walked.accepted,
            random=random,
        )
        look = len(chain.states) >= min(int((1 + GROWTH) * found.steps), least or np.inf, max_steps)
        found = diagnose(chain.states) if look else found
        may = look and chain.retrainings and len(chain.states) <= EARLY * max_steps
        low, where = _ignored(emulator, walked) if may and found.slow else (-np.inf, now.coords)
        if low > TOO_LOW:
            retrainings = chain.retrainings - 1
            points = emulator.with_points(few, np.concatenate([where, walked.now.coords]), MOST_EVER).points
            emulator = Emulator.of(few, layout, points)
            flat = walked.states.reshape(-1, walked.states.shape[-1])
            chain = replace(
                chain, states=walked.states[-1:], log_prob=walked.log_prob[-1:], accepted=0.0, root=_root(flat),
                leap=lead.fitting_leap(walked.now.coords, retrainings), training_points=points,
                retrainings=retrainings,
            )  # fmt: skip
            found = diagnose(chain.states)
        keep(chain)
    return chain
