"""The two fitting procedures of Holzschuch & Pacanowski 2015 (Section 5.8), and the test that the first one needs.

Where diffraction is all that matters, a BRDF is a function of f = (2/lambda) sin(theta_h) cos(theta_d) alone, and so
its gradient over (theta_h, theta_d) is along that of f: det(grad rho, grad f) = 0 (Eq. 14-15).

**Two steps.** Diffuse albedo and diffraction lobe are fitted where that determinant is below 1e-2; then, with these
held, the reflected lobe on all bins. **One step.** All 15 parameters at once.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from merlfit.fitting.fit.levenberg_marquardt import Solution, solve, solve_many
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.transforms import Layout, layout_of
from merlfit.merl_io.samples import Samples
from merlfit.model.measured import Measured
from merlfit.model.rivals.hp15 import HP15

ALONG = 1e-2  # 1/(sr um): largest determinant where diffraction is taken to be all
DIFFRACTED, REFLECTED = ("a", "k_w", "diffuse_albedo"), ("beta", "p", "k_s", "F0")
DARK = 1e-6  # k_s of the first step, which knows of no reflected light


def determinant(samples: Samples) -> np.ndarray:
    """det(grad rho, grad f) of the azimuths' mean, (C, H, D), in 1/(sr um); NaN where nothing is measured.

    HP15 averages over phi_d first, and takes the derivatives of f from its formula.
    """
    counted = samples.weight > 0
    with np.errstate(invalid="ignore"):
        mean = np.sum(np.where(counted, samples.value, 0.0), -1) / counted.sum(-1)
    by_half, by_difference = (np.gradient(mean, x, axis=k) for k, x in ((1, samples.theta_h), (2, samples.theta_d)))
    theta_h, theta_d = samples.theta_h[:, None], samples.theta_d
    f_by_half, f_by_difference = 2 * np.cos(theta_h) * np.cos(theta_d), -2 * np.sin(theta_h) * np.sin(theta_d)
    wavelength = np.array(samples.bands.wavelengths_um)[:, None, None]
    return (by_half * f_by_difference - by_difference * f_by_half) / wavelength


def selected(samples: Samples, most: float = ALONG) -> Samples:
    """Those where the test finds diffraction alone; the others keep no weight."""
    along = np.abs(np.nan_to_num(determinant(samples), nan=np.inf)) < most
    return replace(samples, weight=samples.weight * along[..., None])


def layout(samples: Samples) -> Layout:
    """The 15 parameters, without an apparatus, as HP15 fits them."""
    return layout_of(Measured(HP15(), "off"), bands=samples.bands)


def solve_some(objective: Objective, z: np.ndarray, names: Sequence[str], max_steps: int = 100) -> Solution:
    """:func:`levenberg_marquardt.solve` over some parameters, the others held where ``z`` has them.

    Returns:
        the solution with all free coordinates; its normal equations are those of the moved ones.
    """
    slices = objective.layout.slices  # of values, which are the coordinates: nothing is fixed or tied
    moved = np.concatenate([np.arange(slices[name].start, slices[name].stop) for name in names])
    kept = np.append(moved, objective.layout.size)

    def whole(part: np.ndarray) -> np.ndarray:
        found = np.array(z, float)
        found[moved] = part
        return found

    def evaluate(points: np.ndarray) -> np.ndarray:
        return objective.normal_equations(whole(points[0]))[None, :, kept[:, None], kept]

    (found,) = solve_many(evaluate, np.asarray(z, float)[None, moved], max_steps)
    return replace(found, z=whole(found.z))


def one_step(samples: Samples, z: np.ndarray, max_steps: int = 100) -> Solution:
    """All parameters at once, on all bins."""
    return solve(Objective(layout(samples), make_problem(samples)), z, max_steps)


def two_steps(samples: Samples, z: np.ndarray, max_steps: int = 100) -> Solution:
    """Diffuse and diffracted light where they are alone, then reflected light on all bins."""
    own = layout(samples)
    start = own.values(np.asarray(z, float)[None])
    dark = own.free({**{name: x[0] for name, x in start.items()}, "k_s": DARK})
    first = solve_some(Objective(own, make_problem(selected(samples))), dark, DIFFRACTED, max_steps)
    lit = np.array(z, float)
    for name in DIFFRACTED:
        lit[own.slices[name]] = first.z[own.slices[name]]
    return solve_some(Objective(own, make_problem(samples)), lit, REFLECTED, max_steps)


def random_start(own: Layout, rng: np.random.Generator) -> np.ndarray:
    """As HP15 begins: every parameter evenly in [0, 1), colours alike in all channels, moved inside the bounds."""
    return own.free({q.name: np.full(len(own.bands) if q.per_channel else (), rng.uniform()) for q in own.parameters})
