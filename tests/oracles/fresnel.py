"""Colour of the two lobes: unpolarised Fresnel reflectance (HP17 Eq. 3-4) and the Rayleigh-Rice factor Q (Eq. 10)."""

import mpmath as mp
import numpy as np


def fresnel(cos_theta, n, k=0.0):
    """Unpolarised Fresnel reflectance of an interface of complex index eta = n + i k, HP17 Eq. 3-4.

    n may be below 1 (leaving a denser medium): total internal reflection is the square root turning imaginary.
    One angle at a time, 30 digits inside, correct to the last bit or two of a float.
    """
    with mp.workdps(30):
        eta2 = mp.mpc(n, k) ** 2
        cosine = mp.mpf(cos_theta)
        inner = mp.sqrt(eta2 - (1 - cosine**2))
        f_s = abs((cosine - inner) / (cosine + inner)) ** 2
        f_p = abs((eta2 * cosine - inner) / (eta2 * cosine + inner)) ** 2
        return float((f_s + f_p) / 2)


def q_from_cosines(cos_i, cos_o, cos_phi, n, k=0.0):
    """Q of HP17 Eq. 10 from cosines (arrays welcome); cos_phi is 1 in the mirror direction, where Q = 2 F."""
    eta2 = complex(n, k) ** 2
    sin2_i, sin2_o, sin_phi = 1 - cos_i**2, 1 - cos_o**2, np.sqrt(np.maximum(1 - cos_phi**2, 0))
    c_i, c_o = np.sqrt(eta2 - sin2_i + 0j), np.sqrt(eta2 - sin2_o + 0j)
    q0, q1 = (eta2 - 1) / (cos_i + c_i), (eta2 - 1) / (eta2 * cos_i + c_i)
    q2, q3 = 1 / (cos_o + c_o), 1 / (eta2 * cos_o + c_o)
    q_ss, q_sp, q_ps = q0 * q2 * cos_phi, q0 * q3 * c_o * sin_phi, q1 * q2 * c_i * sin_phi
    q_pp = q1 * q3 * (c_i * c_o * cos_phi - eta2 * np.sqrt(np.maximum(sin2_i * sin2_o, 0)))
    return sum(np.abs(q) ** 2 for q in (q_ss, q_sp, q_ps, q_pp))


def rayleigh_rice_q(theta_i, theta_o, phi, n, k=0.0):
    """Q of HP17 Eq. 10 as printed, phi = phi_o - phi_i - pi (0 in the mirror direction). About 1e-14 relative.

    Q sums over the two incident polarisations instead of averaging: a lobe of unpolarised light carries Q/2.
    """
    return float(q_from_cosines(np.cos(theta_i), np.cos(theta_o), np.cos(phi), n, k))
