"""The posterior of a fit, from its likelihood to the file with its chain and its draws."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import Array

from ...merl_io.archive import arrays
from ...merl_io.atomic import WriteError
from ...merl_io.samples import Samples
from ...merl_io.scattered import ScatteredSamples
from ...merl_io.source import opened
from ...model.derived import derived
from ..fit.outcome import Fitted
from ..fit.problem import make_problem
from ..fit.transforms import Layout
from ..support.clock import Report, Stage, silent
from ..support.kept import kept
from ..support.threads import SHARES, one_core_a_call, side_by_side
from .chain import Chain, ChainError, begin, extend, read_chain, write_chain
from .diagnosis import diagnose
from .emulator import Emulator
from .importance import Posterior, correct
from .likelihood import COMPARED, likelihood_of_all, stand_in

LIKELIHOOD = "residuals of a covariance"  # which one a chain is of: that of another version is not gone on with
DRAWN = ("draws_free", "weights", "log_ratio", "log_likelihood", "values")  # arrays of a finished chain


@dataclass(frozen=True)
class Sampled:
    """Draws from the posterior in units of physics.

    Attributes:
        posterior: in free coordinates. values: physical values of its draws, (n, P). derived: quantities of its draws
            by name, (n,) or (n, C). at_fit: of the fit.
    """

    posterior: Posterior
    values: np.ndarray
    derived: Mapping[str, np.ndarray]
    at_fit: Mapping[str, np.ndarray]


@kept()
def _physical(layout: Layout, draws: Array) -> tuple[Array, dict[str, Array]]:
    material, wavelengths = layout.material, layout.bands.wavelengths_um
    return jax.vmap(layout.flat)(draws), jax.lax.map(lambda z: derived(layout.values(z), material, wavelengths), draws)


def physical(layout: Layout, draws: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Physical values (n, P) and derived quantities of draws (n, P) in free coordinates."""
    count = -(-len(draws) // SHARES)
    padded = np.concatenate([draws, np.repeat(draws[:1], count * SHARES - len(draws), 0)])
    shares = side_by_side(lambda few: jax.device_get(_physical(layout, few)), np.split(padded, SHARES))
    values, found = jax.tree.map(lambda *x: np.concatenate(x)[: len(draws)], *shares)
    return values, found


def draw(
    fitted: Fitted,
    samples: Samples | ScatteredSamples,
    max_steps: int,
    seed: int,
    path: Path,
    resume: bool = False,
    report: Report = silent,
) -> Posterior:
    """Sample until the chain is long enough, and correct it; the chain is in ``path`` at every look at it.

    Args:
        samples: those that were fitted. max_steps: of the whole chain, at the most.
        seed: of walkers and moves.
        path: .npz with the chain. resume: go on with the chain in it.

    Raises:
        merlfit.fitting.posterior.chain.ChainError: there is no chain to go on with, it is damaged, or of another fit.
    """
    layout, solution = fitted.layout, fitted.solution
    few = stand_in(layout, samples, solution, fitted.noise)

    def say(done: int, most: int) -> None:
        words = f"step {done} of at most {most}" if most else f"tuning, step {done}"
        report(Stage(f"posterior: {words}", done / most if most else None))

    drawn: dict[str, np.ndarray] = {}
    if resume:
        chain = read_chain(path, solution.z)
        refuse_other_model(path, layout)
        drawn = _drawn(path)  # those that the result names, until there are new ones
        if drawn and not diagnose(chain.states).failures():
            chain = replace(chain, retrainings=0)  # one that was long enough once is not given up
        emulator = Emulator.of(few, layout, chain.training_points)
    else:
        chain, emulator = begin(few, layout, solution.z, fitted.noise.covariance, seed, say)

    def keep(chain: Chain) -> None:
        if said := _unwritten(path, {**_names(layout), **drawn, **chain.arrays()}):
            report(f"posterior: {said}")

    problem = make_problem(samples, precision="float32")  # 1e-6 of S is 1e-6 N of log L

    def say_draw(done: int, most: int) -> None:
        report(Stage(f"posterior: all data, draw {done} of {most}", done / most))

    least, whole = 0, None
    while True:
        chain = extend(chain, few, layout, emulator, max_steps, say, keep, least)
        if whole is None:
            some = chain.states[-1, :COMPARED]
            whole = likelihood_of_all(layout, solution.z, problem, fitted.noise, some)
        found = correct(chain, few.log_likelihood, whole, layout.coordinates, say_draw)
        if not len(chain.states) < min(found.wanted, max_steps):
            return found
        chain, least = replace(chain, retrainings=0), found.wanted  # long enough once: it is not given up


def _unwritten(path: Path, found: dict[str, np.ndarray]) -> str:
    """Write a chain; in words why it cannot be written, which is no reason to give up the posterior."""
    try:
        write_chain(path, found)
    except WriteError as error:
        return f"the chain is not kept: {error}"
    return ""


def _drawn(path: Path) -> dict[str, np.ndarray]:
    """Weighted draws in the file of a chain, and what goes with them; nothing while it is unfinished."""
    try:
        with opened(path, ChainError) as (file, _):
            return arrays(file, lambda name: name in DRAWN or name.startswith("derived_"))
    except ChainError:
        raise
    except ValueError:
        raise ChainError(f"{path}: its draws are damaged; delete it to start a new chain") from None


def refuse_other_model(path: Path, layout: Layout) -> None:
    """Refuse the chain of a model with other settings, or other wavelengths: its coordinates may be the same.

    Raises:
        merlfit.fitting.posterior.chain.ChainError: it is.
    """
    try:
        with opened(path, ChainError) as (file, _):
            found = arrays(file, "model".__eq__, texts=("model",))
        other = json.loads(str(found["model"])) != json.loads(_model(layout))
    except ChainError:
        raise
    except (ValueError, KeyError, RecursionError):
        other = True
    if other:
        raise ChainError(
            f"{path}: is the chain of a fit with other settings or wavelengths, or of another version of merlfit: "
            "fit again, into another folder"
        )


def _model(layout: Layout) -> str:
    """What a layout's model is, without its parameters, and of which likelihood its chains are."""
    settings: Any = asdict(layout.model)  # pyright: ignore[reportArgumentType] - models are dataclasses
    return json.dumps([layout.material.name, settings, list(layout.bands.wavelengths_um), LIKELIHOOD])


def _names(layout: Layout) -> dict[str, np.ndarray]:
    told = {"names": layout.names, "coordinates": layout.coordinates, "model": _model(layout)}
    return {name: np.array(text) for name, text in told.items()}


@one_core_a_call
def sample(
    fitted: Fitted,
    samples: Samples | ScatteredSamples,
    max_steps: int,
    seed: int,
    path: Path,
    resume: bool = False,
    report: Report = silent,
) -> Sampled:
    """:func:`draw`, and what the draws are in units of physics; all of it in ``path``.

    Raises:
        merlfit.fitting.posterior.chain.ChainError: there is no chain to go on with, or one of another fit.
        RuntimeError: whatever else stops a sampler.
    """
    try:
        return _sampled(fitted, samples, max_steps, seed, path, resume, report)
    except ChainError:
        raise
    except Exception as error:  # raised again: what was fitted before is kept, and named by the caller
        raise RuntimeError(f"the sampler: {type(error).__name__}: {error}") from error


def _sampled(
    fitted: Fitted,
    samples: Samples | ScatteredSamples,
    max_steps: int,
    seed: int,
    path: Path,
    resume: bool,
    report: Report,
) -> Sampled:
    found, layout = draw(fitted, samples, max_steps, seed, path, resume, report), fitted.layout
    values, quantities = physical(layout, np.concatenate([found.draws, fitted.solution.z[None]]))
    done = Sampled(
        found, values[:-1], {k: x[:-1] for k, x in quantities.items()}, {k: x[-1] for k, x in quantities.items()}
    )
    draws = {
        "draws_free": found.draws, "weights": found.weights, "log_ratio": found.log_ratio,
        "log_likelihood": found.log_likelihood, "values": done.values,
    }  # fmt: skip
    told = {**_names(layout), **found.chain.arrays(), **draws}
    if said := _unwritten(path, {**told, **{f"derived_{k}": x for k, x in done.derived.items()}}):
        return replace(done, posterior=replace(found, message=f"{found.message}; {said}"))
    return done
