"""Where the fine stage of a fit begins, the same for merlfit and for what it is compared with; merlfit's fine stage."""

import time

from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.starts import start_hints
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline.models import candidates, layout_for
from merlfit.fitting.pipeline.search import COARSE_ORDER, cheaper, fit_coarse, make_coarse
from merlfit.fitting.settings.config import load
from merlfit.merl_io.binary import read

REPEATS = 3
# Where either side stops: relative decrease of cost (OFFSET_TOLERANCE squared), tolerance on z (rtol of `solve`).
TOLERANCES = {"ftol": 1e-6, "xtol": 1e-5}


def coarse_optimum(path, body):
    """Config, layout, samples of all bins, and the coarse optimum from which `run.fit` goes on."""
    config = load(body=body, posterior=False)
    (model,) = candidates(config)
    layout, samples = (
        layout_for(config, model),
        weighted_samples(read(path), config.exponents[0], config.fit.theta_max),
    )
    (found,) = fit_coarse([cheaper(layout, COARSE_ORDER)], start_hints(samples), *make_coarse(samples), config)
    return config, layout, samples, found.z


def fine_stage(config, layout, samples, start):
    """Problem, solution and seconds of gathering and solving, repeatedly, without the first time."""
    seconds = []
    for _ in range(REPEATS + 1):
        begun = time.perf_counter()
        problem = make_problem(samples)
        solution = solve(Objective(layout, problem), start, config.fit.max_steps)
        seconds.append(time.perf_counter() - begun)
    return problem, solution, seconds[1:]
