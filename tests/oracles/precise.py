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
from types import SimpleNamespace

import mpmath as mp

DIGITS = 30
STEP = mp.mpf(10) ** -16  # of differences, of second order: at n = 1 and 89.99 degrees F has a third derivative of 1e22


def exactly(function):
    """Arguments as mpf, 30 digits inside, results kept: differences ask for some integrals many times over."""
    kept, signature = cache(function), inspect.signature(function)

    @wraps(function)
    def wrapped(*args, **named):
        with mp.workdps(DIGITS):
            bound = signature.bind(*args, **named).arguments
            return +kept(*(x if name == "order" or isinstance(x, bool) else mp.mpf(x) for name, x in bound.items()))

    return wrapped


def still(x):
    """x to six digits: what nodes are placed by stays where it is under the differences of `slope`.

    A converged rule is as good for the derivative of the integrand, and what does not depend on the argument that moves
    is found among the results kept.
    """
    return mp.mpf(mp.nstr(x, 6))


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
    points = _radii(theta_h, B, c, beta, p)
    peak = p / (mp.pi * beta**2 * mp.gamma(1 / p))
    sin_h, cos_h, total = mp.sin(theta_h), mp.cos(theta_h), mp.mpf(0)
    for t, weight in panels(points, order):
        tan_m = mp.exp(t)
        cos_m = 1 / mp.sqrt(1 + tan_m**2)
        density = peak * mp.exp(-((tan_m / beta) ** (2 * p))) * tan_m**2 / cos_m
        total += weight * density * _ring(tan_m * cos_m, cos_m, sin_h, cos_h, B, c, order)
    return total


def _radii(theta_h, B, c, beta, p, edges=()):
    """Ends of panels in t = log tan(theta_m): see `convolve`; ``edges`` are other angles with a singularity."""
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
    for edge in (mp.pi / 2 - theta_h, *edges):
        angles += [edge, *(edge + sign * mp.mpf(4) ** -j for j in range(1, 7) for sign in (-1, 1))]
    least = mp.mpf(10) ** -15
    special = (mp.log(mp.tan(x)) for x in angles if least < x < mp.pi / 2 - least)
    return sorted([*points, *(t for t in special if first < t < last)])


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


# --- Other ways to blur the lobe


def interpolant(function, count):
    """The polynomial through the values of a function at ``count`` Chebyshev nodes of [0, 1]."""
    angles = [mp.pi * (j + mp.mpf(1) / 2) / count for j in range(count)]
    values = [function((1 + mp.cos(x)) / 2) for x in angles]
    factors = [
        2 * mp.fsum(f * mp.cos(k * x) for f, x in zip(values, angles, strict=True)) / count for k in range(count)
    ]

    def at(x):
        after, now = mp.mpf(0), mp.mpf(0)
        for factor in reversed(factors[1:]):  # Clenshaw
            after, now = now, factor + (4 * x - 2) * now - after
        return factors[0] / 2 + (2 * x - 1) * now - after

    return at


@cache
def _legendre_rule(order):
    """t = log tan(theta), measure sin(theta) dtheta, and by degree P_l(cos theta) with it, at nodes for every lobe."""
    points = [mp.mpf(t) for t in range(-26, -10, 2)] + [mp.mpf(t) / 2 for t in range(-20, 29)]
    nodes, polynomials = list(panels(points, 24)), []
    cosines = [1 / mp.sqrt(1 + mp.exp(2 * t)) for t, _ in nodes]
    measure = [weight * mp.exp(2 * t) * x**3 for (t, weight), x in zip(nodes, cosines, strict=True)]
    before, now = [mp.mpf(0)] * len(nodes), measure
    for k in range(order + 1):
        polynomials.append(now)
        following = [((2 * k + 1) * x * a - k * b) / (k + 1) for x, a, b in zip(cosines, now, before, strict=True)]
        before, now = now, following
    return [mp.atan(mp.exp(t)) for t, _ in nodes], polynomials


@cache
def _moments(function, order, *arguments):
    """Int_0^(pi/2) f P_l(cos theta) sin(theta) dtheta, l = 0 .. order."""
    angles, polynomials = _legendre_rule(order)
    values = [function(theta, *arguments) for theta in angles]
    return [mp.fdot(values, row) for row in polynomials]


@exactly
def zonal(theta_h, B, c, beta, p, order):
    """(S * D)(theta_h) without amplitude as zonal harmonics to degree ``order``, HP17 Eq. 61-64 in plain moments.

    Moments to 1e-13 of the zeroth, for beta and 1/B down to 1e-4: the edge of an EPD of p = 5 is what decides.
    """
    total, before, now = mp.mpf(0), mp.mpf(0), mp.mpf(1)
    pairs = zip(_moments(lobe, order, B, c), _moments(epd, order, beta, p), strict=True)
    for k, (of_lobe, of_normals) in enumerate(pairs):
        total += (2 * k + 1) * of_lobe * of_normals * now
        before, now = now, ((2 * k + 1) * mp.cos(theta_h) * now - k * before) / (k + 1)
    return mp.pi * total


def scaled(table):
    """(S * D)(theta_h) without amplitude as a scaled lobe (HP17 Eq. 39-41, times cos^2) whose table is taken for exact.

    Args:
        table: log s and q - log(1 + B^2), (2, 28, 9, 12, 9), at Chebyshev nodes of the coordinates below.
    """
    numbers = [[[[[mp.mpf(float(x)) for x in row] for row in z] for z in y] for y in x] for x in table]

    @cache
    def along_B(x):
        weights = _lagrange(x, 28)
        return [
            [[[mp.fdot(weights, [half[u][j][k][m] for u in range(28)]) for m in range(9)] for k in range(12)]
             for j in range(9)] for half in numbers
        ]  # fmt: skip

    @exactly
    def scaled_lobe(theta_h, B, c, beta, p):
        widest = mp.mpf("1.05") / (1 + (mp.mpf("0.4") / p) ** mp.mpf("5.5"))
        rows = along_B(mp.log1p((2 * B) ** 2) / mp.log1p(mp.mpf(1820) ** 2))
        by_c = _lagrange(mp.log((c - 1) / (mp.mpf(1.01) - 1)) / mp.log(5 / (mp.mpf(1.01) - 1)), 9)
        by_beta = _lagrange(mp.log(beta * 1000) / mp.log(widest * 1000), 12)
        by_p = _lagrange(mp.log(p * 5) / mp.log(25), 9)
        log_s, shift = (
            mp.fdot(by_c, [mp.fdot(by_beta, [mp.fdot(by_p, row) for row in y]) for y in half]) for half in rows
        )
        form = 1 + ((1 + B**2) * mp.exp(shift) - 1) * mp.sin(theta_h) ** 2
        return mp.exp(log_s) * form ** (-(c + 1) / 2) * mp.cos(theta_h) ** 2

    return scaled_lobe


def _lagrange(x, count):
    """Weights of the values at Chebyshev nodes of [0, 1] in their polynomial at x: the barycentric formula."""
    angles = [mp.pi * (j + mp.mpf(1) / 2) / count for j in range(count)]
    weights = [(-1) ** j * mp.sin(angle) / (2 * x - 1 - mp.cos(angle)) for j, angle in enumerate(angles)]
    return [weight / mp.fsum(weights) for weight in weights]


@cache
def _facet_ring(t, directions, B, c, phase, n, k, coloured, order):
    """Integral of Q/2 (1 - A) S (i.m)+ (o.m)+ over the azimuth of normals m at log tan(theta_m) = t.

    Azimuth from h, cut where a facet turns away from i or o and at h, in panels of s between the cuts, where
    alpha = width sinh(s). Nodes stay where they are under differences.
    """
    sin_h, cos_h, cos_d, along, beside = directions  # the last two: sin(theta_d) times cosine and sine of phi_d
    cos_m = 1 / mp.sqrt(1 + mp.exp(2 * t))
    sin_m = mp.exp(t) * cos_m
    product, difference = sin_h * sin_m, sin_h * cos_m - cos_h * sin_m
    offset = 1 / still(B) ** 2 + difference**2
    width = mp.sqrt(offset / product) if product * 10**4 > offset else mp.mpf(100)
    cuts = [-mp.pi, mp.mpf(0), mp.pi]
    for sign in (1, -1):
        x, y, z = cos_d * sin_h + sign * along * cos_h, sign * beside, cos_d * cos_h - sign * along * sin_h
        length = mp.hypot(x, y) * sin_m
        if length > z * cos_m:
            reach = mp.acos(-z * cos_m / length)
            cuts += [(mp.atan2(y, x) + end + mp.pi) % (2 * mp.pi) - mp.pi for end in (-reach, reach)]
    total = mp.mpf(0)
    for start, end in pairwise(sorted(cuts)):
        first, last = mp.asinh(start / width), mp.asinh(end / width)
        count = int((last - first) / 2.5) + 1
        for s, weight in panels([first + (last - first) * j / count for j in range(count + 1)], order):
            azimuth = width * mp.sinh(s)
            half = mp.sin(azimuth / 2) ** 2
            versed = difference**2 / (1 + cos_h * cos_m + product) + 2 * product * half
            tilt = along * (cos_h * sin_m - sin_h * cos_m - 2 * cos_h * sin_m * half)
            tilt += beside * sin_m * mp.sin(azimuth)
            i_m, o_m = cos_d * (1 - versed) + tilt, cos_d * (1 - versed) - tilt
            if min(i_m, o_m) <= 0:
                break  # i and o keep their signs between the cuts
            value = i_m * o_m * (1 + B**2 * versed * (2 - versed)) ** (-(c + 1) / 2)
            value *= -mp.expm1(-phase * (1 - versed) ** 2)
            if coloured:
                value *= diffraction_colour(i_m, o_m, 2 * cos_d**2 - 1 - i_m * o_m, n, k)
            total += weight * mp.cosh(s) * value
    return total * width


def exact_lobe(theta_h, theta_d, phi_d, B, phase, n, k, c, beta, p, coloured, order=10):
    """Int Q/2 (1 - A) S D (i.m)+ (o.m)+ domega_m of HP17 Eq. 27, without amplitude: rings of normals about n.

    ``phase`` is that of A at theta_d. Panels in the radius as for `convolve`, with others towards the rings where a
    great circle i.m = 0 or o.m = 0 begins and where both meet.
    """
    sin_h, cos_h, cos_d, sin_d = mp.sin(theta_h), mp.cos(theta_h), mp.cos(theta_d), mp.sin(theta_d)
    along, beside = sin_d * mp.cos(phi_d), sin_d * mp.sin(phi_d)
    cos_i, cos_o = cos_d * cos_h - along * sin_h, cos_d * cos_h + along * sin_h
    # the great circles cross on the axis (i x o)/|i x o|, whose component along n is sin(phi_d) sin(theta_h)
    edges = mp.asin(cos_i), mp.asin(cos_o), mp.acos(min(abs(mp.sin(phi_d) * sin_h), mp.mpf(1)))
    radii = _radii(theta_h, *(still(x) for x in (B, c, beta, p)), edges)
    directions = sin_h, cos_h, cos_d, along, beside
    peak, total = p / (mp.pi * beta**2 * mp.gamma(1 / p)), mp.mpf(0)
    for t, weight in panels(radii, order):
        density = peak * mp.exp(2 * t - (mp.exp(t) / beta) ** (2 * p)) * mp.sqrt(1 + mp.exp(2 * t))
        if density * weight * B**2 > mp.mpf(10) ** -14:  # the lobe's integral is of order 1/B^2 or more
            total += weight * density * _facet_ring(t, directions, B, c, phase, n, k, coloured, order)
    return total


# --- A facet's own lobe, for the conserving split


@cache
def _share(b_over_lambda, c):
    """`renormalisation` as a function of cos^2(theta_d): interpolated to 1e-12 in asinh(b/lambda (1 - sin theta_d))."""
    longest = mp.asinh(b_over_lambda)
    along = interpolant(lambda x: renormalisation(1 - mp.sinh(x * longest) / b_over_lambda, b_over_lambda, c), 40)
    return lambda cos2: along(mp.asinh(b_over_lambda * cos2 / (1 + mp.sqrt(1 - cos2))) / longest)


@exactly
def lobe_albedo(theta_d, wavelength_um, b, c, sigma_s, renormalised, exact, order=10):
    """Directional albedo of a facet's own lobe at |F| = 1, light at theta_d: Int (1 - A) S_HS d^2 o_p over the disc.

    Along rays from the lobe's centre to the boundary of the disc, in v of asinh(b r/lambda) = T sin^2(v): cos_o has its
    root at the boundary, and grazing light one at the centre. (1 - A) is (1 - A_spec) cos^2(theta_h), or that of Eq. 23
    where ``exact``. To 1e-5, mostly 1e-9.
    """
    ratio, s, cos_i = b / wavelength_um, mp.sin(theta_d), mp.cos(theta_d)
    share_of = _share(ratio, c) if renormalised else lambda cos2: mp.mpf(1)
    strength, total = (4 * mp.pi * sigma_s / wavelength_um) ** 2, mp.mpf(0)
    ladder = [x for x in (mp.mpf(4) ** -j for j in range(10)) if 8 * x > cos_i]
    points = sorted([mp.mpf(0), mp.pi / 2, mp.pi, *(mp.pi / 2 - x for x in ladder), *(mp.pi / 2 + x for x in ladder)])
    for phi, weight in panels(points, order):
        cosine, root = s * mp.cos(phi), mp.sqrt(1 - (s * mp.sin(phi)) ** 2)
        rho = cos_i**2 / (cosine + root) if cosine > 0 else root - cosine
        end = mp.asinh(ratio * rho)
        count = int(end / 2) + 2
        for v, dv in panels([mp.pi / 2 * j / count for j in range(count + 1)], order):
            t = end * mp.sin(v) ** 2
            r = mp.sinh(t) / ratio
            cos_o = mp.sqrt(max((rho - r) * (r + cosine + root), mp.mpf(0)))
            cos2_d = (1 + cos_i * cos_o - s**2 - r * cosine) / 2
            cos2_h = (cos_i + cos_o) ** 2 / (4 * cos2_d)
            share = share_of(cos2_d)
            phase = strength * share * cos2_d
            taken = -mp.expm1(-phase * cos2_h) if exact else -mp.expm1(-phase) * cos2_h
            total += weight * dv * mp.sin(2 * v) * end * mp.tanh(t) * mp.cosh(t) ** (1 - c) * taken / share
    return (c - 1) / mp.pi * total


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


@cache
def _footprints(theta):
    """Angles theta_h and weights of D there in the pixel seen at theta by the standard apparatus: a footprint of 1/200.

    Gauss panels in log theta_h up to 9 footprints, stretched by 1/cos(theta); periodic trapezoid rule in the azimuth.
    """
    width, azimuths = mp.mpf(1) / 200, 128
    turns = [(mp.cos(x), mp.sin(x)) for x in (mp.pi * (j + mp.mpf(1) / 2) / azimuths for j in range(azimuths))]
    sin_t, cos_t, rings = mp.sin(theta), mp.cos(theta), []
    points = [mp.log(width) - 9 + j for j in range(9)] + [mp.log(width) + mp.mpf(j) / 2 for j in range(10)]
    for log_angle, weight in panels([x for x in points if x < mp.log(9 * width / cos_t) + 1], 10):
        angle = mp.exp(log_angle)
        total, versine = mp.mpf(0), 2 * mp.sin(angle / 2) ** 2
        for cosine, sine in turns:
            along, across = mp.sin(angle) * cosine * cos_t - versine * sin_t, mp.sin(angle) * sine
            cos_o = mp.cos(angle) * cos_t - mp.sin(angle) * cosine * sin_t
            cos_i = mp.cos(angle) * cos_t + mp.sin(angle) * cosine * sin_t
            if min(cos_i, cos_o) > 0:
                total += cos_o * mp.exp(-(along**2 + across**2) / (2 * width**2))
        rings.append((angle, weight * angle * mp.sin(angle) * total))
    return rings


@exactly
def derived_exponent(beta, p):
    """k of HP17 Eq. 60 by least squares of log loss at 10, 15 .. 80 degrees; the blur of D to 1e-6."""

    def signal(degrees):
        return mp.fsum(epd(angle, beta, p) * weight for angle, weight in _footprints(mp.radians(degrees)))

    laws = {degrees: 2 * mp.log(1 - (mp.mpf(degrees) / 90) ** 2) for degrees in range(10, 81, 5)}
    losses = mp.fsum(law * mp.log(signal(degrees) / signal(0)) for degrees, law in laws.items())
    return losses / mp.fsum(law**2 for law in laws.values())


# --- The assembled model

CHOICES = {
    "body": "none", "diffraction": "quadrature", "zonal_order": 100, "fresnel": "exact", "masking": "smith",
    "renormalised": True, "split": "printed", "colour": "rayleigh_rice", "acquisition": "off",
}  # fmt: skip
BLURS = {
    "lobe": lambda theta_h, B, c, beta, p, order: lobe(theta_h, B, c),
    "zonal": zonal,
    "quadrature": lambda theta_h, B, c, beta, p, order: convolve(theta_h, B, c, beta, p),
}  # and ``scaled``, by who has its table


def two_scale(theta_h, theta_d, phi_d, wavelength_um, **rest):
    """The BRDF of HP17 Eq. 24-33 at half and difference angles: effects, as `CHOICES` has them else, and parameters.

    Under the conserving split lobes are not blurred, and the surface's albedo is an integral by fixed rules, to 1e-6.
    """
    with mp.workdps(DIGITS):
        theta_h, theta_d, phi_d, lam = (mp.mpf(x) for x in (theta_h, theta_d, phi_d, wavelength_um))
        e = SimpleNamespace(**{name: rest.pop(name, choice) for name, choice in CHOICES.items()})
        v = SimpleNamespace(**{name: mp.mpf(x) for name, x in rest.items()})
        v.index = (v.n, v.k) if e.body == "none" else (v.eta, mp.mpf(0))
        even, odd = mp.cos(theta_h) * mp.cos(theta_d), mp.sin(theta_h) * mp.sin(theta_d) * mp.cos(phi_d)
        cos_i, cos_o = even - odd, even + odd
        if min(cos_i, cos_o) <= 0:
            return mp.mpf(0)
        lobes = _lobes(theta_h, theta_d, phi_d, cos_i, cos_o, lam, v, e)
        conserving = e.split == "conserving"
        under = 0 if e.body == "none" else (_unlit if conserving else _body)(e.body, cos_i, cos_o, v)
        if conserving and not (e.body == "none" and e.diffraction == "off" and e.masking != "none"):
            lit, seen = (_surface_albedo(mp.acos(cos), lam, v, e) for cos in (cos_i, cos_o))
            lobes /= max(lit, 1) * max(seen, 1)
            if under:
                under *= max(1 - lit, 0) * max(1 - seen, 0) / _mean_transmittance(lam, v, e)
        if e.acquisition == "off":
            return lobes + under
        k = {"free": lambda: v.grazing_exponent, "derived": lambda: derived_exponent(v.beta, v.p)}
        return (lobes + under) * grazing(cos_i, cos_o, k.get(e.acquisition, lambda: e.acquisition)())


def _lobes(theta_h, theta_d, phi_d, cos_i, cos_o, lam, v, e, many=False):
    """Mirror term and diffraction lobe; where there are ``many`` directions, dear functions of theta_d interpolated."""
    cos_d, sin_d = mp.cos(theta_d), mp.sin(theta_d)
    shadow, mirror = _shadow(cos_i, cos_o, v, e), _reflectance(cos_d, v, e) * epd(theta_h, v.beta, v.p)
    mirror /= 4 * cos_i * cos_o
    if e.diffraction == "off":
        return shadow * mirror
    ratio, share = v.b / lam, mp.mpf(1)
    if e.renormalised:
        share = _share(ratio, v.c)(cos_d**2) if many else renormalisation(sin_d, ratio, v.c)
    phase, B = share * (4 * mp.pi * v.sigma_s * cos_d / lam) ** 2, 2 * ratio * cos_d
    kept = mp.exp(-phase)
    if e.split == "conserving":
        facet = (lam, v.b, v.c, v.sigma_s, e.renormalised, e.diffraction == "exact")
        kept = 1 - (_facet_albedos(*facet)(2 * theta_d / mp.pi) if many else lobe_albedo(theta_d, *facet))
    dot, coloured = mp.cos(2 * theta_d) - cos_i * cos_o, e.colour == "rayleigh_rice"
    if e.diffraction == "exact":
        surface = v.c, v.beta, v.p
        blurred = exact_lobe(theta_h, theta_d, phi_d, B, phase, *v.index, *surface, coloured) / (cos_i * cos_o)
    else:
        blurred = -mp.expm1(-phase) * BLURS[e.diffraction](theta_h, B, v.c, v.beta, v.p, e.zonal_order)
        if coloured:
            blurred *= diffraction_colour(cos_i, cos_o, dot, *v.index)
    if not coloured:
        blurred *= _reflectance(cos_d, v, e)
    return shadow * (kept * mirror + lobe_amplitude(ratio, v.c) / share * blurred)


def _reflectance(cos_d, v, e):
    return (schlick if e.fresnel == "schlick" else fresnel)(cos_d, *v.index)


def _shadow(cos_i, cos_o, v, e):
    """G: Smith's, height-correlated (Heitz 2014 Eq. 99) or 1."""
    if e.masking == "none":
        return mp.mpf(1)
    hidden = [1 / masking(cos, v.beta, v.p) - 1 for cos in (cos_i, cos_o)]
    return 1 / (1 + sum(hidden)) if e.masking == "height_correlated" else 1 / ((1 + hidden[0]) * (1 + hidden[1]))


def _body(kind, cos_i, cos_o, v):
    if kind == "lambert":
        return lambert(v.albedo)
    return (plastic if kind == "plastic" else subsurface)(cos_i, cos_o, v.eta, v.albedo)


def _unlit(kind, cos_i, cos_o, v):
    """A body without the transmittances T(i) T(o), times their mean; ``subsurface`` is not here."""
    if kind == "lambert":
        return lambert(v.albedo)
    mean = 1 - external_diffuse_reflectance(v.eta)
    return v.albedo * mean / (mp.pi * v.eta**2 * (1 - _internal(v.eta) * v.albedo))


@cache
def _facet_albedos(*facet):
    """`lobe_albedo` as a function of theta_d/(pi/2), to 1e-5."""
    return interpolant(lambda x: lobe_albedo(x * mp.pi / 2, *facet, order=6), 20)


@cache
def _viewers(theta_i, narrowest):
    """Viewers of light at theta_i, half of them by symmetry: (theta_h, theta_d, cos_o), measure cos_o domega_o.

    Elevations in panels geometric towards the horizon; azimuths from the mirror direction, stretched onto it.
    """
    cos_i, sin_i, nodes = mp.cos(theta_i), mp.sin(theta_i), []
    ladder = [(mp.pi / 2 - theta_i) * mp.mpf(3) ** j for j in range(-1, 12)]
    for up, weight in panels([mp.mpf(0), *(x for x in ladder if x < mp.pi / 2), mp.pi / 2], 8):
        cos_o, sin_o = mp.sin(up), mp.cos(up)
        near = mp.hypot(narrowest * (cos_i + cos_o), sin_i - sin_o)
        width = near / mp.sqrt(sin_i * sin_o)
        last = mp.asinh(mp.pi / width)
        count = int(last / 1.5) + 1
        for s, ds in panels([last * j / count for j in range(count + 1)], 6):
            half = mp.sin(width * mp.sinh(s) / 2) ** 2
            across = mp.sqrt((sin_i - sin_o) ** 2 + 4 * sin_i * sin_o * half)  # |i_p + o_p|
            theta_h = mp.atan2(across, cos_i + cos_o)
            theta_d = mp.acos(mp.hypot(across, cos_i + cos_o) / 2)
            measure = 2 * weight * ds * width * mp.cosh(s) * cos_o * sin_o
            nodes.append(((theta_h, theta_d, cos_o), measure))
    return nodes


def _surface_albedo(theta_i, lam, v, e):
    """Directional albedo of the lobes."""
    widths = [v.beta] if e.diffraction == "off" else [v.beta, lam / v.b / mp.cos(theta_i)]
    nodes, cos_i = _viewers(theta_i, still(min(widths))), mp.cos(theta_i)
    return mp.fsum(
        weight * _lobes(theta_h, theta_d, 0, cos_i, cos_o, lam, v, e, many=True)
        for (theta_h, theta_d, cos_o), weight in nodes
    )


def _mean_transmittance(lam, v, e):
    """Int (1 - min(1, E)) 2 cos sin dtheta."""
    points = [mp.radians(x) for x in (0, 50, 75, 86, 90)]
    return mp.fsum(
        weight * mp.sin(2 * theta) * max(1 - _surface_albedo(theta, lam, v, e), 0)
        for theta, weight in panels(points, 6)
    )
