"""The formulas of the two-scale model at 30 digits, for single points and any extreme: mpmath throughout.

Arguments are those of the functions of the same name in ``model/``, as floats or mpf, taken for exact. Arithmetic has
30 digits (40 where digits cancel). Integrals run over fixed rules whose nodes move smoothly with the arguments, so that
differences of their values are derivatives as good as the values: 1e-20 for one-dimensional integrals, 1e-8 for the
convolution. The routes are other ones than the fast code's: complex arithmetic for the colours, periodic and doubly
exponential trapezoid rules for Lambda, the boundary of the disc for the renormalisation, the closed form for diffuse
Fresnel reflectances, plain panels of the spherical integral for the convolution.
"""

import inspect
from functools import cache, wraps
from itertools import pairwise

import mpmath as mp

DIGITS = 30
STEP = mp.mpf(10) ** -16  # of differences, of second order: at n = 1 and 89.99 degrees F has a third derivative of 1e22


def exactly(function):
    """Arguments as mpf, 30 digits inside, results kept: differences ask for some integrals many times over."""
    kept = cache(function)

    @wraps(function)
    def wrapped(*args, **named):
        with mp.workdps(DIGITS):
            bound = inspect.signature(function).bind(*args, **named)
            return +kept(*(x if name == "order" else mp.mpf(x) for name, x in bound.arguments.items()))

    return wrapped


def slope(function, at, name, lower=None, upper=None):
    """Derivative of ``function(**at)`` in one argument, by differences of second order.

    Central, or one-sided where the argument sits on ``lower`` or ``upper``, the edge of its range.
    """
    with mp.workdps(DIGITS):
        x = mp.mpf(at[name])
        h = STEP * (abs(x) if x else 1)
        edge = mp.mpf(1) if x == lower else mp.mpf(-1) if x == upper else None

        def value(shift):
            return function(**{**at, name: x + shift})

        if edge is None:
            return (value(h) - value(-h)) / (2 * h)
        h *= edge / 10
        return (4 * value(h) - value(2 * h) - 3 * value(0)) / (2 * h)


# --- Colour


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


# --- Microfacet normals


@exactly
def epd(theta, beta, p):
    """Exponential power distribution, HP17 Eq. 34-35; 0 at and beyond the horizon."""
    if mp.cos(theta) <= 0:
        return mp.mpf(0)
    peak = p / (mp.pi * beta**2 * mp.gamma(1 / p))
    return peak * mp.exp(-((mp.tan(theta) / beta) ** (2 * p))) / mp.cos(theta) ** 4


@exactly
def smith_lambda(tau, p):
    """Lambda of HP17 Eq. 36-37, q over the whole line, in w = s tau = cosh(v):

    2 p/(pi Gamma(1/p)) tau^-2 Int_0^inf cosh v sinh v exp(-(cosh v/tau)^(2p)) [sinh v - atan(sinh v)] dv.

    The integrand is even and analytic for |Im v| < pi/2, of double exponential decay: a trapezoid rule over the line.
    """
    if tau == 0:
        return mp.mpf(0)
    start = tau ** (-2 * p)
    if start > 10**6:
        return mp.mpf(0)
    with mp.workdps(DIGITS + 10):
        # e^(-2 pi strip/step), and the Gaussian of variance 1/(2 p start) that is left where the exponent is large
        strip = min(mp.pi / 2, mp.pi / (4 * p)) / mp.mpf(1.2)
        step = min(2 * mp.pi * strip, mp.pi**2 / mp.sqrt(80 * p * (start + 15))) / 80
        step = min(step, mp.mpf(1) / 8)
        end = mp.acosh(tau * (start + 90 + 20 / p) ** (1 / (2 * p)))
        total = mp.mpf(0)
        for j in range(1, int(end / step) + 2):
            up = mp.exp(j * step)
            w, z = (up + 1 / up) / 2, (up - 1 / up) / 2
            total += w * z * mp.exp(start - (w / tau) ** (2 * p)) * (z - mp.atan(z))
        return 2 * p / (mp.pi * mp.gamma(1 / p)) * total * step * mp.exp(-start) / tau**2


@exactly
def masking(cos_theta, beta, p):
    """Smith's G1, HP17 Eq. 38."""
    if cos_theta <= 0:
        return mp.mpf(0)
    return 1 / (1 + smith_lambda(beta * mp.sqrt(1 - cos_theta**2) / cos_theta, p))


# --- Diffraction


@cache
def gauss(order):
    """Gauss-Legendre nodes and weights on [0, 1]."""
    with mp.workdps(DIGITS + 10):
        rule = []
        for j in range(order):
            x = mp.cos(mp.pi * (j + mp.mpf(3) / 4) / (order + mp.mpf(1) / 2))
            for _ in range(8):
                low, high = mp.mpf(1), x
                for k in range(2, order + 1):
                    low, high = high, ((2 * k - 1) * x * high - (k - 1) * low) / k
                rate = order * (low - x * high) / (1 - x**2)
                x -= high / rate
            rule.append(((1 + x) / 2, 1 / ((1 - x**2) * rate**2)))
        return rule


def panels(points, order):
    """Composite Gauss rule between neighbouring points."""
    for a, b in pairwise(points):
        for u, w in gauss(order):
            yield a + (b - a) * u, (b - a) * w


@exactly
def renormalisation(sin_theta, b_over_lambda, c):
    """sigma_rel^2/sigma_s^2, HP17 Eq. 17-19: the lobe's mass on the unit disc, seen from the lobe's centre.

    In direction phi from there the disc reaches as far as rho(phi), and up to that radius the lobe's mass is known:
    1/pi Int_0^pi 1 - (1 + (b rho/lambda)^2)^(-(c-1)/2) dphi.
    """
    s, total = sin_theta, mp.mpf(0)
    ladder = [mp.mpf(4) ** -j for j in range(12)]
    points = sorted([mp.mpf(0), mp.pi / 2, mp.pi, *(mp.pi / 2 - x for x in ladder), *(mp.pi / 2 + x for x in ladder)])
    for phi, weight in panels(points, 20):
        cosine, root = s * mp.cos(phi), mp.sqrt(1 - (s * mp.sin(phi)) ** 2)
        rho = (1 - s) * (1 + s) / (cosine + root) if cosine > 0 else root - cosine
        total -= weight * mp.expm1(-(c - 1) / 2 * mp.log1p((b_over_lambda * rho) ** 2))
    return total / mp.pi


@exactly
def lobe_amplitude(b_over_lambda, c):
    """Peak of the K-correlation lobe."""
    return (c - 1) / (2 * mp.pi) * b_over_lambda**2


@exactly
def lobe(theta_h, B, c):
    """K-correlation lobe at theta_h, with the cos^2 of HP17 Eq. 33."""
    return (1 + (B * mp.sin(theta_h)) ** 2) ** (-(c + 1) / 2) * mp.cos(theta_h) ** 2


@exactly
def specular_share(theta_d, wavelength_um, b, c, sigma_s):
    """A_spec, HP17 Eq. 25, with sigma_rel at theta_d."""
    share = renormalisation(mp.sin(theta_d), b / wavelength_um, c)
    return mp.exp(-share * (4 * mp.pi * sigma_s * mp.cos(theta_d) / wavelength_um) ** 2)


@exactly
def convolve(theta_h, B, c, beta, p, order=12):
    """(S * D)(theta_h) of HP17 Eq. 33 without amplitude: rings about n in t = log tan(theta_m), by panels.

    Panels are short where D falls, and geometric towards the ring through h (width 1/B) and towards the horizon of h,
    each with a singularity of the complex t-plane farther away than its own length. ``order`` is that of the panels.
    """
    ladder = [mp.mpf(4) ** (j - 1) / B for j in range(40) if mp.mpf(4) ** (j - 1) < 4 * B]
    low = mp.log(min(beta, 1 / B)) - 17
    fall = exponent = 60 + (c + 1) * mp.log1p(B) + 2 / p * mp.log(10 + 2 / p)
    for _ in range(20):
        exponent = fall + mp.mpf(1.5) / p * mp.log(exponent)
    top = mp.log(exponent) / (2 * p)
    bend = max(mp.log(beta) - 3 / p, low)
    count = int(max(bend - low, 0) / 2) + 1
    points = [low + (bend - low) * j / count for j in range(count)]
    count = int((mp.log(beta) + top - bend) / min(mp.mpf(1), 1 / p)) + 1
    points += [bend + (mp.log(beta) + top - bend) * j / count for j in range(count + 1)]
    first, last = points[0], points[-1]
    angles = [theta_h, *(theta_h - x for x in ladder), *(theta_h + x for x in ladder)]
    edge = mp.pi / 2 - theta_h
    angles += [edge, *(edge - mp.mpf(4) ** -j for j in range(1, 7)), *(edge + mp.mpf(4) ** -j for j in range(1, 7))]
    least = mp.mpf(10) ** -15
    special = (mp.log(mp.tan(x)) for x in angles if least < x < mp.pi / 2 - least)
    points = sorted([*points, *(t for t in special if first < t < last)])
    peak = p / (mp.pi * beta**2 * mp.gamma(1 / p))
    sin_h, cos_h, total = mp.sin(theta_h), mp.cos(theta_h), mp.mpf(0)
    for t, weight in panels(points, order):
        tan_m = mp.exp(t)
        cos_m = 1 / mp.sqrt(1 + tan_m**2)
        density = peak * mp.exp(-((tan_m / beta) ** (2 * p))) * tan_m**2 / cos_m
        total += weight * density * _ring(tan_m * cos_m, cos_m, sin_h, cos_h, B, c, order)
    return total


def _ring(sin_m, cos_m, sin_h, cos_h, B, c, order):
    """Integral of S over the azimuth of m, warped as phi = width sinh(s) onto the peak at phi = 0."""
    product, difference = sin_h * sin_m, sin_h * cos_m - cos_h * sin_m
    cos_difference = cos_h * cos_m + product
    if cos_difference <= 0:  # an h below the horizon by a rounding of pi/2 does not see the normals next to n
        return mp.mpf(0)
    near = difference**2 / (2 * (1 + cos_difference))  # sin^2 of half the difference of the angles
    offset = 1 / B**2 + difference**2
    width = mp.sqrt(offset / product) if product * 10**4 > offset else mp.mpf(100)
    end = mp.pi if cos_h * cos_m >= product else mp.acos(-cos_h * cos_m / product)
    last = mp.asinh(end / width)
    count = int(last / 2.5) + 1
    total = mp.mpf(0)
    for s, weight in panels([last * j / count for j in range(count + 1)], order):
        up = mp.exp(s)
        v = near + product * mp.sin(width * (up - 1 / up) / 4) ** 2
        total += weight * (up + 1 / up) * (1 + 4 * B**2 * v * (1 - v)) ** (-(c + 1) / 2) * (1 - 2 * v) ** 2
    return total * width


# --- Bodies and apparatus


@exactly
def external_diffuse_reflectance(n):
    """r_e in closed form (IL Eq. 10), digits enough for its cancellation."""
    if n == 1:
        return mp.mpf(0)
    with mp.workdps(4 * DIGITS):
        return (
            mp.mpf(1) / 2
            + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
            - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
            + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * mp.log(n)
            + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * mp.log((n - 1) / (n + 1))
        )


def _internal(n):
    return 1 - (1 - external_diffuse_reflectance(n)) / n**2


def _transmittance(cos_i, cos_o, n):
    return (1 - fresnel(cos_i, n, 0)) * (1 - fresnel(cos_o, n, 0))


@exactly
def lambert(albedo):
    """rho_d/pi."""
    return albedo / mp.pi


@exactly
def plastic(cos_i, cos_o, n, albedo):
    """HP17 Eq. 43 with the erratum."""
    return _transmittance(cos_i, cos_o, n) * albedo / (mp.pi * n**2 * (1 - _internal(n) * albedo))


@exactly
def subsurface(cos_i, cos_o, n, albedo):
    """HP17 Eq. 44-47 with the erratum."""
    inner = sum(mp.sqrt(1 - (1 - cos**2) / n**2) for cos in (cos_i, cos_o))
    boundary = (1 + _internal(n)) / (1 - _internal(n))
    root = mp.sqrt(3 * (1 - albedo))
    multiple = mp.exp(-root) * (1 + mp.exp(-4 * boundary * root / 3)) / (2 * mp.pi)
    return albedo * _transmittance(cos_i, cos_o, n) * (1 / (4 * mp.pi * inner) + multiple)


@exactly
def grazing(cos_i, cos_o, exponent):
    """p(i, o), HP17 Eq. 59-60."""
    base = [1 - (2 * mp.acos(cos) / mp.pi) ** 2 for cos in (cos_i, cos_o)]
    return (base[0] * base[1]) ** exponent


# --- The assembled model


def two_scale(theta_h, theta_d, phi_d, wavelength_um, body, diffraction, beta, p, b=1, c=2, sigma_s=0, n=1, k=0,
              eta=None, albedo=0):  # fmt: skip
    """The BRDF of HP17 Eq. 24-33 at half and difference angles, for every body and way of diffraction."""
    with mp.workdps(DIGITS):
        theta_h, theta_d, phi_d, lam, b = (mp.mpf(x) for x in (theta_h, theta_d, phi_d, wavelength_um, b))
        if body != "none":
            n, k = eta, 0
        even, odd = mp.cos(theta_h) * mp.cos(theta_d), mp.sin(theta_h) * mp.sin(theta_d) * mp.cos(phi_d)
        cos_i, cos_o, cos_d = even - odd, even + odd, mp.cos(theta_d)
        if min(cos_i, cos_o) <= 0:
            return mp.mpf(0)
        surface = fresnel(cos_d, n, k) * epd(theta_h, beta, p) / (4 * cos_i * cos_o)
        if diffraction != "off":
            mirror = specular_share(theta_d, lam, b, c, sigma_s)
            shape = lobe if diffraction == "lobe" else lambda *first: convolve(*first, beta, p)
            peak = lobe_amplitude(b / lam, c) / renormalisation(mp.sin(theta_d), b / lam, c)
            blurred = peak * shape(theta_h, 2 * b * cos_d / lam, c)
            colour = diffraction_colour(cos_i, cos_o, mp.cos(2 * theta_d) - cos_i * cos_o, n, k)
            surface = mirror * surface + colour * (1 - mirror) * blurred
        bodies = {
            "none": lambda: 0,
            "lambert": lambda: lambert(albedo),
            "plastic": lambda: plastic(cos_i, cos_o, n, albedo),
            "subsurface": lambda: subsurface(cos_i, cos_o, n, albedo),
        }
        return masking(cos_i, beta, p) * masking(cos_o, beta, p) * surface + bodies[body]()
