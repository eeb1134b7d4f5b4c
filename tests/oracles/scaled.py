"""The blurred diffraction lobe as a lobe of another height and width, HP17 Eq. 39-41: what the best one comes to."""

import numpy as np
from scipy.optimize import minimize_scalar

FLOOR = 1e-2  # of the peak: misfits count relative to the lobe above it, and to it below


def form(theta_h, s, q, c, squared_cosine=True):
    """s (1 + 4 g^2 sin^2 theta_h)^(-(c+1)/2), q = log(1 + 4 g^2), times the cos^2 that S has (Eq. 33) or as printed."""
    found = s * (np.cos(theta_h) ** 2 + np.exp(q) * np.sin(theta_h) ** 2) ** (-(c + 1) / 2)
    return found * np.cos(theta_h) ** 2 if squared_cosine else found


def best(theta_h, blurred, c, squared_cosine=True):
    """The form of the least misfit whose height is the lobe's, the first of these half angles being the least."""

    def misfit(q):
        away = form(theta_h, blurred[0], q, c, squared_cosine) - blurred
        return np.mean((away / (blurred + FLOOR * blurred[0])) ** 2)

    start = min(np.arange(-6.0, 15.0, 0.5), key=misfit)
    q = minimize_scalar(misfit, bracket=(start - 0.5, start, start + 0.5)).x
    return form(theta_h, blurred[0], q, c, squared_cosine)
