"""The scatter formulas of optical design programs, fitted to a material for one incidence and one channel at a time.

x = |beta - beta0| is the distance of the projections of viewer and mirror direction on the surface. All logarithms are
natural ones; a row of the hemisphere's viewers at one x counts like any other, x rising by a constant factor.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ...merl_io.scattered import ScatteredMeasurement
from ..fit.total_scatter import SAME
from ..support.choices import THETA_MAX

NEAREST = 1e-4  # x of the first row
ROWS, TURNS = 60, 24  # values of x, azimuths of beta - beta0
DISC = 200  # midpoints along either axis of the square around the projected hemisphere
Logarithm = Callable[[np.ndarray, np.ndarray, np.ndarray, float], np.ndarray]


class Formula(NamedTuple):
    """A formula of the BRDF (1/sr).

    Attributes:
        text: in words of programs. source: of these. names: of the parameters. log: its logarithm, of the logarithms
            of the parameters, x, cos_i cos_o and the wavelength (um). starts: the same of x at which it begins to fall.
        told: parameters by name as programs take them, of the logarithms and the wavelength.
        model: whose fits have this formula. given: the logarithms, of such a fit's values in a channel and the
            wavelength.
    """

    text: str
    source: str
    log: Logarithm
    starts: Callable[[float, float], Sequence[float]]
    told: Callable[[np.ndarray, float], dict[str, float]]
    model: str
    given: Callable[[Mapping[str, float], float], Sequence[float]]


def _abg(q: np.ndarray, x: np.ndarray, cosines: np.ndarray, wavelength_um: float) -> np.ndarray:
    return q[0] - np.logaddexp(q[1], np.exp(q[2]) * np.log(np.maximum(x, 1e-12)))


def _harvey(q: np.ndarray, x: np.ndarray, cosines: np.ndarray, wavelength_um: float) -> np.ndarray:
    return q[0] - np.exp(q[2]) / 2 * np.log1p((x / np.exp(q[1])) ** 2)


def _dittman(q: np.ndarray, x: np.ndarray, cosines: np.ndarray, wavelength_um: float) -> np.ndarray:
    return _harvey(q, x, cosines, wavelength_um) + np.log(cosines)


def _as_dittman(q: np.ndarray, wavelength_um: float) -> dict[str, float]:
    """Roughness, B and s of K-correlation; 4 pi^2 dn^2 / lambda^4 times the PSD at f = 0 is the first number."""
    K, B, s = np.exp(q[0]), wavelength_um / np.exp(q[1]), float(np.exp(q[2]))
    return {"sigma_um": float(np.sqrt(K / _height(float(B), s, wavelength_um))), "B_um": float(B), "s": s}


def _of_dittman(v: Mapping[str, float], wavelength_um: float) -> list[float]:
    height = v["sigma"] ** 2 * _height(v["B"], v["s"], wavelength_um)
    return np.log([height, wavelength_um / v["B"], v["s"]]).tolist()


def _height(B_um: float, s: float, wavelength_um: float) -> float:
    """The first number of K-correlation for a roughness of 1 um."""
    ends = np.log1p((B_um / wavelength_um) ** 2)
    # [1 - (1 + (B / lambda)^2)^(1 - s / 2)] / (s - 2), finite at s = 2
    share = ends / 2 if abs(s - 2) < 1e-9 else -np.expm1((1 - s / 2) * ends) / (s - 2)
    return float(16 * np.pi**2 * B_um**2 / (wavelength_um**4 * 2 * np.pi * share))


FORMULAS: dict[str, dict[str, Formula]] = {
    "abg": {
        "ABg": Formula(
            "A / (B + x^g)", "OpticStudio's help, 'ABg Model Scattering'; x = |beta - beta0|", _abg,
            lambda level, x: (level + 2 * np.log(x), 2 * np.log(x), np.log(2.0)),
            lambda q, wavelength_um: dict(zip("ABg", np.exp(q).tolist(), strict=True)),
            "abg", lambda v, wavelength_um: np.log([v["A"], v["B"], v["g"]]).tolist(),
        ),
    },
    "k-correlation": {
        "Harvey-Shack": Formula(
            "b0 (1 + (x / L)^2)^(S / 2)",
            "Pfisterer 2011, 'Approximated scatter models for stray light analysis'; FRED, ASAP", _harvey,
            lambda level, x: (level, np.log(x), np.log(2.0)),
            lambda q, wavelength_um: {"b0": float(np.exp(q[0])), "L": float(np.exp(q[1])), "S": -float(np.exp(q[2]))},
            "harvey-shack", lambda v, wavelength_um: np.log([v["b0"], v["L"], v["s"]]).tolist(),
        ),
        "K-correlation": Formula(
            "4 pi^2 2^2 / lambda^4 cos_i cos_s sigma^2 (s - 2) B^2 / (2 pi (1 - (1 + (B / lambda)^2)^(1 - s / 2))) "
            "(1 + (B x / lambda)^2)^(-s / 2)",
            "Dittman 2006, doi:10.1117/12.678320; OpticStudio's K-correlation", _dittman,
            lambda level, x: (level, np.log(x), np.log(2.0)), _as_dittman,
            "k-correlation", _of_dittman,
        ),
    },
}  # fmt: skip


class Around(NamedTuple):
    """Viewers around the mirror direction of an incidence, all that are seen.

    Attributes:
        o: unit vectors, (N, 3), light being at azimuth 0. x: as above, (N,). share: one for all of an x, (N,).
    """

    o: np.ndarray
    x: np.ndarray
    share: np.ndarray


def around(theta_i: float) -> Around:
    """Viewers at `ROWS` values of x and `TURNS` azimuths, without those that fits leave out."""
    x = np.geomspace(NEAREST, 1 + np.sin(THETA_MAX), ROWS)[:, None]
    turn = 2 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
    p, q = x * np.cos(turn) - np.sin(theta_i), x * np.sin(turn)
    seen = np.hypot(p, q) < np.sin(THETA_MAX)
    o = np.stack([p[seen], q[seen], np.sqrt(1 - p[seen] ** 2 - q[seen] ** 2)], -1)
    share = seen / np.maximum(seen.sum(1, keepdims=True), 1)
    return Around(o, np.broadcast_to(x, seen.shape)[seen], share[seen])


def nearest(formula: Formula, value: np.ndarray, at: Around, cos_i: float, wavelength_um: float) -> np.ndarray:
    """Logarithms of the parameters with which the logarithm of a formula is nearest to that of values (1/sr), (N,)."""
    there = value > 0
    log, root, x, cosines = np.log(value[there]), np.sqrt(at.share[there]), at.x[there], cos_i * at.o[there, 2]

    def residuals(q: np.ndarray) -> np.ndarray:
        return root * (formula.log(q, x, cosines, wavelength_um) - log)

    level, found = float(log[np.argmin(x)]), []
    for begin in (0.003, 0.03, 0.3):
        bounds = np.array([(-60.0, 60.0), (-40.0, 12.0), (-6.0, 3.0)]).T
        found.append(least_squares(residuals, np.clip(formula.starts(level, begin), *bounds), bounds=bounds))
    return min(found, key=lambda each: each.cost).x


def errors(found: np.ndarray, value: np.ndarray, share: np.ndarray) -> dict[str, float]:
    """Distance of logarithms (rms, of positive values) and sMAPE of a formula's BRDF from other values, (N,)."""
    there = value > 0
    log = np.log(found[there] / value[there])
    relative = np.abs(found - value) / np.maximum(np.abs(found) + np.abs(value), 1e-300)
    return {
        "log_rms": float(np.sqrt(np.average(log**2, weights=share[there]))),
        "smape": float(np.average(relative, weights=share)),
    }


def tis_of(formula: Formula, q: np.ndarray, theta_i: float, wavelength_um: float) -> float:
    """Integral of a formula over the hemisphere of viewers, which is that over the unit disc of beta."""
    log_r = np.linspace(np.log(NEAREST / 10), np.log(2.0), 4 * DISC)
    turn = np.pi * (np.arange(DISC) + 0.5) / DISC
    x = np.exp(log_r)[:, None]
    rho2 = x**2 + np.sin(theta_i) ** 2 - 2 * x * np.sin(theta_i) * np.cos(turn)
    inside = rho2 < 1
    cosines = np.cos(theta_i) * np.sqrt(np.where(inside, 1 - rho2, 1.0))
    f = np.where(inside, np.exp(formula.log(q, np.broadcast_to(x, inside.shape), cosines, wavelength_um)), 0.0)
    return float(np.trapezoid(2 * np.pi / DISC * np.sum(f, 1) * x[:, 0] ** 2, log_r))


def against(formula: Formula, q: np.ndarray, measured: ScatteredMeasurement, theta_i: float, channel: int) -> Any:  # noqa: ANN401 - JSON
    """Errors against a file's own samples of an incidence; None where it has none."""
    rows = np.abs(measured.theta_i - theta_i) < SAME
    rows &= np.isfinite(measured.values[channel]) & (measured.theta_o < THETA_MAX)
    if not rows.any():
        return None
    theta_o, phi = measured.theta_o[rows], measured.phi[rows]
    x = np.hypot(np.sin(theta_o) * np.cos(phi) + np.sin(theta_i), np.sin(theta_o) * np.sin(phi))
    wavelength_um = measured.bands.wavelengths_um[channel]
    found = np.exp(formula.log(q, x, np.cos(theta_i) * np.cos(theta_o), wavelength_um))
    return errors(found, measured.values[channel, rows], np.ones(len(x)))
