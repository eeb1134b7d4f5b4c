"""30 digits: functions that keep their results, and derivatives by differences of them."""

import inspect
from functools import cache, wraps

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
