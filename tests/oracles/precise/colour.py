"""What an interface reflects: Fresnel, Schlick, and Q of the diffracted light, in complex arithmetic."""

import mpmath as mp

from .arithmetic import exactly


def _inner(cos_theta, eta2):
    return mp.sqrt(eta2 - (1 - cos_theta**2))


@exactly
def fresnel(cos_theta, n, k):
    """Unpolarised Fresnel reflectance, HP17 Eq. 3-4; 0 for an index of 1 at any angle."""
    eta2 = mp.mpc(n, k) ** 2
    if eta2 == 1:
        return mp.mpf(0)
    c = _inner(cos_theta, eta2)
    f_s, f_p = (abs((factor * cos_theta - c) / (factor * cos_theta + c)) ** 2 for factor in (1, eta2))
    return (f_s + f_p) / 2


@exactly
def schlick(cos_theta, n, k):
    """Schlick's polynomial."""
    f0 = abs((mp.mpc(n, k) - 1) / (mp.mpc(n, k) + 1)) ** 2
    return f0 + (1 - f0) * (1 - cos_theta) ** 5


@exactly
def diffraction_colour(cos_i, cos_o, projected_dot, n, k):
    """Q/2 of HP17 Eq. 10; cos(phi) is 1 in the mirror direction. Rounded arguments may make |cos(phi)| exceed 1."""
    eta2 = mp.mpc(n, k) ** 2
    if eta2 == 1:
        return mp.mpf(0)
    sines = mp.sqrt((1 - cos_i**2) * (1 - cos_o**2))
    cos_phi = max(mp.mpf(-1), min(mp.mpf(1), -projected_dot / sines)) if sines else mp.mpf(1)
    sin_phi = mp.sqrt(1 - cos_phi**2)
    c_i, c_o = _inner(cos_i, eta2), _inner(cos_o, eta2)
    q0, q1 = (eta2 - 1) / (cos_i + c_i), (eta2 - 1) / (eta2 * cos_i + c_i)
    q2, q3 = 1 / (cos_o + c_o), 1 / (eta2 * cos_o + c_o)
    q_pp = q1 * q3 * (c_i * c_o * cos_phi - eta2 * sines)
    q = (q0 * q2 * cos_phi, q0 * q3 * c_o * sin_phi, q1 * q2 * c_i * sin_phi, q_pp)
    return sum(abs(x) ** 2 for x in q) / 2
