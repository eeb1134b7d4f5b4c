"""The rival models one pair of directions at a time, written from the papers with mpmath, from vectors, slowly.

Nothing of the package is imported. ``i`` and ``o`` are unit vectors, the normal is the third axis; parameters are
scalars (one channel). Each model takes the piece that a test gets wrong on purpose as an argument.
"""

import mpmath as mp

mp.mp.dps = 40


def dot(a, b):
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


def norm(a):
    return mp.sqrt(dot(a, a))


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def scaled(a, s):
    return tuple(x * s for x in a)


def half(i, o):
    total = tuple(x + y for x, y in zip(i, o, strict=True))
    return scaled(total, 1 / norm(total))


def dielectric(cosine, eta):
    """Snell and Fresnel, from the refracted angle."""
    theta = mp.acos(cosine)
    if eta == 1 or theta == 0:
        return ((eta - 1) / (eta + 1)) ** 2
    refracted = mp.asin(mp.sin(theta) / eta)
    s = mp.sin(theta - refracted) / mp.sin(theta + refracted)
    p = mp.tan(theta - refracted) / mp.tan(theta + refracted)
    return (s**2 + p**2) / 2


def schlick(cosine, f0):
    return f0 + (1 - f0) * (1 - cosine) ** 5


def sgd_fresnel(cosine, f0, f1):
    return f0 - f1 * cosine + (1 - f0) * (1 - cosine) ** 5


def sgd_fresnel_without_f0(cosine, f0, f1):
    return f0 - f1 * cosine + (1 - cosine) ** 5


def sgd(i, o, q, fresnel=sgd_fresnel):
    """Bagher et al. 2012."""
    h = half(i, o)
    tan2 = (1 - h[2] ** 2) / h[2] ** 2
    t = q["alpha"] + tan2 / q["alpha"]
    d = q["K"] * mp.exp(-t) / t ** q["p"] / (mp.pi * h[2] ** 4)

    def g1(v):
        past = max(mp.mpf(0), mp.acos(v[2]) - q["theta0"])
        return min(1, max(0, 1 + q["Lambda"] * (1 - mp.exp(q["c"] * past ** q["k"]))))

    f = fresnel(dot(h, i), q["F0"], q["F1"])
    return (q["diffuse_albedo"] + q["albedo"] * f * d * g1(i) * g1(o) / (i[2] * o[2])) / mp.pi


def smooth_cosine(i, o):
    return mp.sqrt(1 - ((i[0] - o[0]) ** 2 + (i[1] - o[1]) ** 2) / 4)


def facet_cosine(i, o):
    return dot(half(i, o), i)


def smooth(i, o, q, cosine=smooth_cosine):
    """Loew et al. 2012, Eq. 10-14."""
    squared = (i[0] + o[0]) ** 2 + (i[1] + o[1]) ** 2
    lobe = (1 + q["B"] * squared) ** -q["C"]
    return q["diffuse_albedo"] / mp.pi + q["A"] * dielectric(cosine(i, o), q["eta"]) * lobe


def v_groove(i, o):
    h = half(i, o)
    return min(1, 2 * h[2] * i[2] / dot(h, i), 2 * h[2] * o[2] / dot(h, o))


def no_masking(i, o):
    return 1


def abc_microfacet(i, o, q, normalisation=mp.pi):
    """Loew et al. 2012, Eq. 15."""
    h = half(i, o)
    d = q["A"] * (1 + q["B"] * (1 - h[2])) ** -q["C"]
    lobe = dielectric(dot(h, i), q["eta"]) * d * v_groove(i, o)
    return q["diffuse_albedo"] / mp.pi + lobe / (normalisation * i[2] * o[2])


def beckmann(h, m):
    return mp.exp(-((mp.tan(mp.acos(h[2])) / m) ** 2)) / (m**2 * h[2] ** 4)


def cook_torrance(i, o, q, masking=v_groove):
    """Cook & Torrance 1982 with Loew's parameters."""
    h = half(i, o)
    f = dielectric(dot(h, i), q["eta"])
    lobe = f * beckmann(h, q["roughness"]) * masking(i, o) / (mp.pi * i[2] * o[2])
    return q["diffuse_albedo"] / mp.pi + q["albedo"] * lobe


def cook_torrance_ngan(i, o, q, normalisation=mp.pi):
    """Cook & Torrance 1982 with Ngan's parameters."""
    h = half(i, o)
    d = beckmann(h, q["roughness"]) / normalisation
    lobe = schlick(dot(h, i), q["F0"]) * d * v_groove(i, o) / (mp.pi * i[2] * o[2])
    return q["diffuse_albedo"] / mp.pi + q["albedo"] * lobe


def he_geometry(i, o):
    """Eq. 76, with its polarisation vectors."""
    incoming, n, total = scaled(i, -1), (0, 0, 1), tuple(x + y for x, y in zip(i, o, strict=True))

    def brackets(k, other):
        s = cross(k, n)
        s = scaled(s, 1 / norm(s))
        return dot(s, other) ** 2 + dot(cross(s, k), other) ** 2

    product = brackets(o, incoming) * brackets(incoming, o)
    return (dot(total, total) / total[2]) ** 2 * product / norm(cross(incoming, o)) ** 4


def he_shadowing(v, q):
    """Eq. 24 and 25 with the errata."""
    x = q["autocorrelation"] / (2 * q["roughness"] * mp.tan(mp.acos(v[2])))
    spill = mp.exp(-(x**2)) / (2 * mp.sqrt(mp.pi) * x) - mp.erfc(x) / 2
    return (1 - mp.erfc(x) / 2) / (spill + 1)


def he_shadowing_as_printed(v, q):
    """Eq. 25 without the exponential."""
    x = q["autocorrelation"] / (2 * q["roughness"] * mp.tan(mp.acos(v[2])))
    return (1 - mp.erfc(x) / 2) / (1 / (2 * mp.sqrt(mp.pi) * x) - mp.erfc(x) / 2 + 1)


def he_roughness(i, o, q):
    """Eq. 80-83, the root by bisection."""

    def obliquity(v):
        tan = mp.tan(mp.acos(v[2]))
        return tan * mp.erfc(q["autocorrelation"] / (2 * q["roughness"] * tan))

    right = (obliquity(i) + obliquity(o)) / mp.sqrt(8 * mp.pi)
    low, high = mp.mpf(0), mp.mpf(1) + right
    for _ in range(140):
        middle = (low + high) / 2
        low, high = (middle, high) if middle * mp.exp(middle**2 / 2) < right else (low, middle)
    return q["roughness"] / mp.sqrt(1 + low**2)


def he_sum(g, e):
    """``Sum_{m>=1} g^m e^-g / (m! m) exp(-e / m)``, term by term until the terms no longer count."""
    total, m, weight = mp.mpf(0), 1, g * mp.exp(-g)
    while True:
        term = weight / m * mp.exp(-e / m)
        total += term
        if m > g and term < total * mp.mpf(10) ** -20 and weight * mp.mpf(10) ** 20 < total:
            return total
        m += 1
        weight *= g / m


def he(i, o, q, shadowing=he_shadowing):
    """He et al. 1991, Eq. 76-84, one wavelength (``q["wavelength"]``)."""
    wavelength, tau, total = q["wavelength"], q["autocorrelation"], tuple(x + y for x, y in zip(i, o, strict=True))
    g = (2 * mp.pi * he_roughness(i, o, q) * (i[2] + o[2]) / wavelength) ** 2
    e = mp.pi**2 * (total[0] ** 2 + total[1] ** 2) * tau**2 / wavelength**2
    d = mp.pi**2 * tau**2 / (4 * wavelength**2) * he_sum(g, e)
    f = dielectric(dot(half(i, o), i), q["eta"])
    lobe = f * he_geometry(i, o) * shadowing(i, q) * shadowing(o, q) * d / (mp.pi * i[2] * o[2])
    return q["diffuse_albedo"] / mp.pi + q["albedo"] * lobe
