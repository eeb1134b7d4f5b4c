"""The two-scale conductor written straight from the paper, in plain NumPy: what merlfit is timed against.

Vectorised over bins, one row of theta_h at a time so that intermediates stay in the cache; complex arithmetic as in
HP17 Eq. 3-10, with the mends of ``docs/physics.md``. (S*D) is a fixed Gauss rule over (theta_m, phi_m) at every
(theta_h, theta_d, channel). Smith's Lambda, which no direction has to itself, is tabulated for each p.

Accuracy: 95 % of the diffraction lobes within the bounds of the fit to 2e-2, the median 2e-6 (merlfit's default order:
2e-4, 1e-5); with half the nodes an axis it is 0.1. Everything else 1e-6 (``tests/test_bench.py``).
"""

import math
from functools import cache

import numpy as np
from scipy.special import gammaln

WAVELENGTHS_UM = np.array([0.645, 0.526, 0.444])
RADII, AZIMUTHS = 48, 16  # Gauss nodes of either panel of theta_m, and of phi_m
SMALLEST = 1e-3  # of the narrower of D and S: facets nearer to the normal than that are left out
TABLE, TABLE_NODES = 1000, 128  # entries of the table of masking, and Gauss nodes of each
RENORMALISATION = 48  # nodes


@cache
def gauss(count):
    """Gauss-Legendre nodes and weights on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(count)
    return (x + 1) / 2, w / 2


def epd(theta, beta, p):
    """D(theta), Eq. 34-35."""
    peak = p / (math.pi * beta**2 * math.exp(gammaln(1 / p)))
    with np.errstate(over="ignore"):
        return peak * np.exp(-((np.tan(theta) / beta) ** (2 * p))) / np.cos(theta) ** 4


def refracted(cos, eta):
    """sqrt(eta^2 - sin^2 theta), Eq. 3."""
    return np.sqrt(eta**2 - 1 + cos**2)


def fresnel(cos, eta):
    """Unpolarised reflectance, Eq. 3-4."""
    c = refracted(cos, eta)
    return (np.abs((cos - c) / (cos + c)) ** 2 + np.abs((eta**2 * cos - c) / (eta**2 * cos + c)) ** 2) / 2


def rayleigh_rice(cos_i, cos_o, projected_dot, eta):
    """Q/2, Eq. 10."""
    c_i, c_o, eta2 = refracted(cos_i, eta), refracted(cos_o, eta), eta**2
    sin_sin = np.sqrt((1 - cos_i**2) * (1 - cos_o**2))
    cos_phi = np.clip(-projected_dot / np.maximum(sin_sin, 1e-12), -1, 1)
    sin2_phi = 1 - cos_phi**2
    s_i, s_o, p_i, p_o = cos_i + c_i, cos_o + c_o, eta2 * cos_i + c_i, eta2 * cos_o + c_o
    ss = cos_phi**2 * np.abs(1 / (s_i * s_o)) ** 2
    sp = sin2_phi * np.abs(c_o / (s_i * p_o)) ** 2
    ps = sin2_phi * np.abs(c_i / (p_i * s_o)) ** 2
    pp = np.abs((c_i * c_o * cos_phi - eta2 * sin_sin) / (p_i * p_o)) ** 2
    return np.abs(eta2 - 1) ** 2 * (ss + sp + ps + pp) / 2


def masking_table(p):
    """G1 = 1/(1 + Lambda) at even steps of tau/(1 + tau), Eq. 36-38 with the inner integral over the whole line."""
    tau = np.linspace(0, 1, TABLE, endpoint=False)[1:]
    tau = (tau / (1 - tau))[:, None]
    furthest = 745 ** (1 / (2 * p))  # slopes beyond have exp(-s^(2p)) = 0
    u, w = gauss(TABLE_NODES)
    reach = np.log(np.maximum(furthest * tau, 1.0))
    ratio = np.exp(reach * u**2)  # s tau, from 1 where facets begin to mask
    slope = ratio / tau
    p22 = p / (math.pi * math.exp(gammaln(1 / p))) * np.exp(-np.minimum(slope ** (2 * p), 745))
    z = np.sqrt(ratio**2 - 1)
    lam = np.sum(2 * slope * p22 * (z - np.arctan(z)) * slope * reach * 2 * u * w, 1)
    return np.concatenate([[1.0], 1 / (1 + lam), [0.0]])


def masking(cos, beta, table):
    """G1 by interpolation."""
    tau = beta * np.sqrt(np.maximum(1 - cos**2, 0)) / np.maximum(cos, 1e-9)
    return np.interp(tau / (1 + tau) * TABLE, np.arange(TABLE + 1), table)


def renormalisation(sin_d, b_over_lambda, c):
    """sigma_rel^2/sigma_s^2, Eq. 17-19: the share of the lobe's circles that lies on the unit disc."""
    s, bl = sin_d[..., None], b_over_lambda[..., None]
    u, w = gauss(RENORMALISATION)
    low, high = np.arcsinh(bl * (1 - s)), np.arcsinh(bl * (1 + s))
    t = low + (high - low) * (1 - np.cos(np.pi * u)) / 2
    r = np.sinh(t) / bl
    inside = np.arccos(np.clip((r**2 + s**2 - 1) / (2 * r * np.maximum(s, 1e-12)), -1, 1)) / np.pi
    density = (c - 1) * np.sinh(t) * np.cosh(t) ** -c * inside
    ring = np.sum(density * (high - low) * np.pi / 2 * np.sin(np.pi * u) * w, -1)
    return 1 - (1 + (b_over_lambda * (1 - sin_d)) ** 2) ** (-(c - 1) / 2) + ring


def blurred(theta_h, B, c, beta, p, radii=RADII, azimuths=AZIMUTHS):
    """(S*D)(theta_h) without amplitude, Eq. 32-33, for one theta_h and all B (...).

    Facets nearer to the normal than to h on a logarithmic scale, the others on one that is dense around theta_h.
    """
    u, w = gauss(radii)
    B = B[..., None]
    half = theta_h / 2
    least = np.minimum(half, SMALLEST * np.minimum(beta, 1 / B))
    near = least * (half / least) ** u
    d_near = near * np.log(half / least) * w
    low, high = -np.arcsinh(B * half), np.arcsinh(B * (np.pi / 2 - theta_h))
    t = low + (high - low) * u
    theta_m = np.concatenate([near, theta_h + np.sinh(t) / B], -1)
    d_theta = np.concatenate([d_near, np.cosh(t) / B * (high - low) * w], -1)
    ring = epd(theta_m, beta, p) * np.sin(theta_m) * d_theta
    product = math.sin(theta_h) * np.sin(theta_m)
    width = np.sqrt((np.sin(theta_m - theta_h) ** 2 + 1 / B**2) / product)[..., None]
    end = np.arcsinh(np.pi / width)
    u, w = gauss(azimuths)
    phi = width * np.sinh(end * u)
    cos_psi = np.cos(theta_m - theta_h)[..., None] - 2 * product[..., None] * np.sin(phi / 2) ** 2
    lobe = np.exp(-(c + 1) / 2 * np.log1p(B[..., None] ** 2 * (1 - cos_psi**2))) * cos_psi**2 * (cos_psi > 0)
    return np.sum(ring * np.sum(lobe * 2 * width * np.cosh(end * u) * end * w, -1), -1)


def brdf(v, theta_h, theta_d, cos_i, cos_o):
    """What MERL's apparatus would have measured of a conductor (Eq. 24-33, 59-60), (3, H, D, P), 1/sr.

    Args:
        v: beta, p, b, c, sigma_s, grazing_exponent, grazing_exponent_diffracted; n and k (3,). theta_h (H,),
            theta_d (D,); cosines (H, D, P).
    """
    wavelength, cos_d = WAVELENGTHS_UM[:, None], np.cos(theta_d)
    eta = (v["n"] + 1j * v["k"])[:, None]
    b_over_lambda = np.broadcast_to(v["b"] / wavelength, (3, len(theta_d)))
    share = renormalisation(np.sin(theta_d), b_over_lambda, v["c"])
    specular = np.exp(-share * (4 * np.pi * v["sigma_s"] * cos_d / wavelength) ** 2)  # Eq. 25
    mirror = specular * fresnel(cos_d, eta) / 4
    amplitude = (1 - specular) * (v["c"] - 1) / (2 * np.pi) * b_over_lambda**2 / share
    table = masking_table(v["p"])
    found = np.empty((3, *cos_i.shape))
    for h, theta in enumerate(theta_h):
        above = (cos_i[h] > 0) & (cos_o[h] > 0)
        i, o = np.where(above, cos_i[h], 1.0), np.where(above, cos_o[h], 1.0)
        lobe = amplitude * blurred(theta, 2 * b_over_lambda * cos_d, v["c"], v["beta"], v["p"])
        colour = rayleigh_rice(i, o, np.cos(2 * theta_d)[:, None] - i * o, eta[..., None])
        base = [np.maximum(1 - (2 / np.pi * np.arccos(cos)) ** 2, 1e-30) for cos in (i, o)]
        loss = [(base[0] * base[1]) ** v[k] for k in ("grazing_exponent", "grazing_exponent_diffracted")]
        rho = loss[0] * (mirror * epd(theta, v["beta"], v["p"]))[..., None] / (i * o)
        rho += loss[1] * colour * lobe[..., None]
        seen = masking(i, v["beta"], table) * masking(o, v["beta"], table)
        found[:, h] = np.where(above, seen * rho, 0.0)
    return found
