"""The two integrators the oracles share: an adaptive Gauss-Legendre rule and an azimuth rule warped onto a peak."""

import numpy as np
from numpy.polynomial.legendre import leggauss

CHUNK = 256  # outer nodes evaluated at once: keeps a 2-D integrand under about 100 MB


def _panels(f, left, right, order):
    """Gauss-Legendre estimate on each panel [left_j, right_j]."""
    x, w = leggauss(order)
    half = (right - left) / 2
    nodes = ((left + right) / 2)[:, None] + half[:, None] * x
    flat = nodes.ravel()
    values = np.concatenate([f(flat[j : j + CHUNK]) for j in range(0, flat.size, CHUNK)])
    return half * (values.reshape(nodes.shape) @ w)


def adaptive(f, points, rtol=1e-10, order=16, max_depth=50):
    """Integral of a one-signed, vectorised f over [points[0], points[-1]], split at the sorted `points`.

    A panel is kept when its 16-point value and that of its two halves differ by less than rtol times the whole
    integral; the halves' value, far better than that difference, is what is added. Raises ArithmeticError rather than
    return a number it could not settle.
    """
    points = np.unique(np.asarray(points, dtype=float))
    left, right = points[:-1], points[1:]
    whole = _panels(f, left, right, order)
    done = 0.0
    for _ in range(max_depth):
        middle = (left + right) / 2
        first, second = _panels(f, left, middle, order), _panels(f, middle, right, order)
        total = abs(done) + np.sum(np.abs(first) + np.abs(second))
        open_ = np.abs(first + second - whole) > rtol * total
        done += np.sum((first + second)[~open_])
        if not np.any(open_):
            return float(done)
        left, right = (
            np.concatenate([left[open_], middle[open_]]),
            np.concatenate([middle[open_], right[open_]]),
        )
        whole = np.concatenate([first[open_], second[open_]])
    raise ArithmeticError(f"the integral did not settle: {left.size} panels still open, first at {left[0]!r}")


def warped(start, end, width, panels=12, order=16):
    """Nodes and weights on [start, end] for an integrand peaked at 0 with the given width and algebraic tails.

    phi = width sinh(s) turns (1 + (phi/width)^2)^(-nu) dphi into cosh(s)^(1 - 2 nu) ds, analytic for |Im s| < pi/2, so
    that panels about one unit of s wide converge to rounding. Arrays broadcast; the nodes are on a new last axis.
    """
    x, w = leggauss(order)
    x = ((np.arange(panels)[:, None] + (x + 1) / 2) / panels).ravel()
    w = np.tile(w / 2 / panels, panels)
    # wider than this the warp is a straight line, and width may be infinite (pole of the sphere)
    width = np.minimum(np.asarray(width, dtype=float), 1e3)[..., None]
    a, b = np.arcsinh(np.asarray(start)[..., None] / width), np.arcsinh(np.asarray(end)[..., None] / width)
    s = a + (b - a) * x
    return width * np.sinh(s), width * np.cosh(s) * (b - a) * w


def geometric(centre, scale, reach, ratio=4.0):
    """Breakpoints centre, centre +- scale ratio^j out to centre +- reach."""
    count = max(1, int(np.ceil(np.log(max(reach / scale, 1.0)) / np.log(ratio))) + 1)
    steps = scale * ratio ** np.arange(-1.0, count)
    return np.concatenate([centre - steps[::-1], [centre], centre + steps])
