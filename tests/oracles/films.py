"""Reflectance of a thin film by the characteristic matrix (Born & Wolf, Principles of Optics, 1.6)."""

import mpmath as mp


def reflectance_of_line(cos_theta, n, k, eta, thickness_um, wavelength_um):
    """Unpolarised, at one wavelength; 30 digits."""
    with mp.workdps(30):
        cosine, eta, thickness = (mp.mpf(x) for x in (cos_theta, eta, thickness_um))
        below, sin2 = mp.mpc(n, -mp.mpf(k)), 1 - mp.mpf(cos_theta) ** 2  # fields go as exp(i omega t) there
        cos_f, cos_b = mp.sqrt(1 - sin2 / eta**2), mp.sqrt(1 - sin2 / below**2)
        if mp.im(below * cos_b) > 0:
            cos_b = -cos_b
        delta, total = 2 * mp.pi * eta * thickness * cos_f / mp.mpf(wavelength_um), mp.mpf(0)
        for outer, film, base in (
            (cosine, eta * cos_f, below * cos_b),  # tilted admittances, s
            (1 / cosine if cosine else mp.inf, eta / cos_f, below / cos_b),  # p
        ):
            if mp.isinf(outer):
                total += 1
                continue
            electric = mp.cos(delta) + 1j * mp.sin(delta) / film * base
            magnetic = 1j * film * mp.sin(delta) + mp.cos(delta) * base
            total += abs((outer * electric - magnetic) / (outer * electric + magnetic)) ** 2
        return total / 2


def reflectance(cos_theta, n, k, eta, thickness_um, wavelength_um, fwhm=0.0, count=401):
    """The mean over a Gaussian band in the wavenumber (1/um), of this full width at half maximum; a float."""
    if not fwhm:
        return float(reflectance_of_line(cos_theta, n, k, eta, thickness_um, wavelength_um))
    sigma = fwhm / (2 * (2 * mp.log(2)) ** 0.5)
    total = weights = mp.mpf(0)
    for j in range(count):
        x = -5 + mp.mpf(10 * j) / (count - 1)
        weight = mp.exp(-(x**2) / 2)
        total += weight * reflectance_of_line(
            cos_theta, n, k, eta, thickness_um, 1 / (1 / mp.mpf(wavelength_um) + x * sigma)
        )
        weights += weight
    return float(total / weights)
