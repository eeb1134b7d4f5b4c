"""What the numbers of a file look like, if not a BRDF in 1/sr over angles in degrees: hints, no more than that."""

import numpy as np

from .binary import SCALES, Measurement
from .grid import merl_grid
from .scattered import ScatteredMeasurement, half_difference

BRIGHT = 1.3  # times the light that arrives: what is reflected beyond that is no error of calibration
RETRO = 3.0  # times as bright on the light's own side as on the mirror's
TILTED = np.radians(20)  # incidence from which these are apart
SPREAD = 0.15  # of cosines' logarithms: pairs of directions that tell a cosine
LEAST = 8  # pairs, or samples of an incidence, to say anything by
MOST = 400  # samples that are looked at for their partners
DRAWN = 1500  # directions of a hemisphere
DENSE = 3000  # samples of an incidence, at the most, that these are compared with
PAIRS = 4_000_000  # of these and samples that are looked at together: 100 MB
FEWEST_AZIMUTHS = 3  # of an incidence, at least: a plane says nothing of the hemisphere
NEAR = np.radians(3.0)  # of two samples that count as one pair of directions


def hints(measured: Measurement | ScatteredMeasurement) -> list[str]:
    """Lines on what the file looks like; of nearly every file none."""
    if isinstance(measured, Measurement):
        return _of_bins(measured)
    plane = measured.values[int(np.argmax(np.nanmedian(measured.values, axis=1)))]
    used = np.isfinite(plane)
    if not used.any():
        return []
    if lines := _radians(measured):
        return lines
    angles = np.stack([measured.theta_i, measured.theta_o, measured.phi])[:, used]
    lines = _reciprocity(angles, plane[used]) + _side(angles, plane[used])
    return lines + (_bright(largest) if (largest := reflected(angles, plane[used])) > BRIGHT else [])


def _of_bins(measured: Measurement) -> list[str]:
    weight = np.where(measured.valid, merl_grid(measured.dims).weight, 0.0)
    albedo = max(float(np.pi * np.sum(weight * np.nan_to_num(x)) / weight.sum()) for x in measured.values)
    if albedo > BRIGHT:
        return _bright(albedo)
    unscaled = albedo / SCALES.max()
    if albedo > 0 and unscaled <= 1:
        return [
            f"it reflects {albedo:.2g} of the light that arrives: if its numbers are a BRDF in 1/sr, they were not "
            "divided by MERL's scale (1, 1.15, 1.66)/1500 when they were written"
        ]
    return []


def _bright(albedo: float) -> list[str]:
    factor = (
        "; if its values are reflectance factors, divide them by pi (of tables: --quantity reflectance_factor)"
        if albedo < 1.1 * np.pi
        else ""
    )
    return [f"it reflects {albedo:.2g} times the light that arrives: its values are no BRDF in 1/sr{factor}"]


def _radians(measured: ScatteredMeasurement) -> list[str]:
    """Angles that were radians already."""
    theta = np.degrees(np.maximum(measured.theta_i, measured.theta_o))
    turns = np.degrees(np.abs(measured.phi)) % 180  # to which signed angles have added 180
    turns = np.minimum(turns, 180 - turns)
    if 0.1 < theta.max() <= np.pi / 2 and turns.max() <= 2 * np.pi + 1e-3 and len(theta) >= LEAST:
        return [
            f"no angle exceeds {max(theta.max(), turns.max()):.4g}: they look like radians, and are read as degrees; "
            "name the columns theta_i_rad, theta_o_rad, phi_rad"
        ]
    return []


def _reciprocity(angles: np.ndarray, value: np.ndarray) -> list[str]:
    """What tells a BRDF times a cosine: f(i, o) and f(o, i) are equal of a BRDF."""
    ratio, cosines = _partners(angles, value)
    if len(ratio) < LEAST:
        return []
    as_it_is, off = (float(np.median(np.abs(x))) for x in (ratio, ratio - cosines))
    power = float(np.median(ratio / cosines))
    if abs(abs(power) - 1) > 0.2 or min(off, float(np.median(np.abs(ratio + cosines)))) > 0.3 * as_it_is:
        return []
    which, tables = ("theta_o", " (of tables: --quantity brdf_cos)") if power > 0 else ("theta_i", "")
    return [
        f"f(i, o) and f(o, i) differ by the ratio of their cosines: the values look like a BRDF times cos {which}; "
        f"divide them by it{tables}"
    ]


def _partners(angles: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of f(i, o)/f(o, i) and of cos theta_o/cos theta_i where samples of both are near to each other."""
    i, o, phi = angles
    apart = np.abs(np.log(np.cos(o) / np.cos(i))) > SPREAD
    rows = np.flatnonzero(apart & (value > 0))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MOST)).astype(int))] if len(rows) else rows
    folded, pairs = np.arccos(np.cos(phi)), []
    for k in rows:
        away = np.maximum(np.maximum(np.abs(i - o[k]), np.abs(o - i[k])), np.abs(folded - folded[k]))
        other = int(np.argmin(away))
        if away[other] < NEAR and value[other] > 0:
            pairs.append((np.log(value[k] / value[other]), np.log(np.cos(o[k]) / np.cos(i[k]))))
    ratio, cosines = np.array(pairs).reshape(-1, 2).T
    return ratio, cosines


def reflected(angles: np.ndarray, value: np.ndarray) -> float:
    """Share of the light that is reflected at least, at the incidence of which most is; 0 where that is not known.

    Directions are drawn as the cosine has them, each has the least of its three nearest samples: what a single sample
    says of a highlight is not taken for all around it.
    """
    theta_i, albedos = np.round(angles[0], 6), [0.0]
    for incidence in np.unique(theta_i) if len(np.unique(theta_i)) <= MOST else []:
        rows = np.flatnonzero(theta_i == incidence)
        at, f = angles[1:, rows], value[rows]
        if cover_hemisphere(*at):
            albedos.append(_hemisphere(at, f))
    return max(albedos)


def cover_hemisphere(theta_o: np.ndarray, phi: np.ndarray) -> bool:
    """Whether an incidence's directions of viewers, (N,), are all over the hemisphere: no line, no spot."""
    azimuths = len(np.unique(np.round(np.degrees(np.arccos(np.cos(phi))))))
    wide = len(phi) >= LEAST and np.ptp(theta_o) > 1.0 and np.ptp(np.abs(np.cos(phi) - 1)) > 1.0
    return bool(wide) and azimuths >= FEWEST_AZIMUTHS


def _hemisphere(at: np.ndarray, f: np.ndarray) -> float:
    k = np.arange(DRAWN) + 0.5
    radius, turn = np.sqrt(k / DRAWN), np.pi * ((k * (np.sqrt(5) - 1) / 2) % 1)
    folded = np.arccos(np.cos(at[1]))
    x, y = np.sin(at[0]) * np.cos(folded), np.sin(at[0]) * np.sin(folded)
    rows = np.unique(np.round([x, y], 3), axis=1, return_index=True)[1]  # one direction is one sample, if there twice
    if len(rows) < LEAST:
        return 0.0
    rows = rows[:: -(-len(rows) // DENSE)]
    least = []
    for part in np.array_split(np.arange(DRAWN), -(-DRAWN * len(rows) // PAIRS)):
        across, along = ((radius * turned(turn))[part, None] for turned in (np.cos, np.sin))
        near = np.argpartition((across - x[rows]) ** 2 + (along - y[rows]) ** 2, 3, axis=1)[:, :3]
        least.append(f[rows][near].min(1))
    inside = radius < np.sin(at[0]).max()
    return float(np.pi * np.mean(np.where(inside, np.concatenate(least), 0.0)))


def _side(angles: np.ndarray, value: np.ndarray) -> list[str]:
    """Whether the highlight is where the light comes from."""
    tilted = angles[0] > TILTED
    theta_h, theta_d, _ = half_difference(*angles)
    mirror, light = (value[tilted & (np.abs(x) < np.radians(10))] for x in (theta_h, theta_d))
    if light.size < 3 or light.max() < RETRO * (np.median(value[tilted]) if not mirror.size else mirror.max()):
        return []
    return [
        "the brightest samples are on the light's own side, at azimuth 0: if that is the mirror's side in your file, "
        "write 180 - phi_deg; if not, it is a retro-reflector"
    ]
