"""Gauss-Newton steps no longer than a radius in which the linear model has proved itself.

Moré 1978, "The Levenberg-Marquardt algorithm: implementation and theory"; Conn, Gould & Toint 2000, "Trust-region
methods", chapters 6 and 7. Tests: ``tests/fitting/test_trust_region.py``.

Free coordinates are scaled by what is known of each parameter beforehand, so that a length in them means something and
the radius is one number. optimistix' Levenberg-Marquardt lengthens its steps only where the linear model is right to
1 %, and creeps; so do its ``IndirectDampedNewtonDescent`` and ``ClassicalTrustRegion`` with our thresholds, which need
at least 1.2 to 8 times as many evaluations. ``results/bench/solver.md`` compares them.

All arrays have leading axes for solves side by side. By NumPy; where JAX traces it, by JAX (:func:`.namespace_of`): a
step is some thousand numbers, and as compiled programs, one for each count of parameters and solves, they took a
second of a new process to trace and load.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from ...model.numerics import TINY, namespace_of
from .coordinates import Numbers

FIRST_RADIUS = 1.0
GOOD, POOR = 0.75, 0.25  # of the promised decrease: more than this lengthens the radius, less than that shortens it
LONGER, SHORTER, MUCH_SHORTER = 2.0, 0.5, 0.25  # times the step; the last where a step led upwards
NEWTON_STEPS = 30  # for the damping that makes a step as long as the radius: monotone, quadratic at the end


class Linear(NamedTuple):
    """Residuals (..., R) and their Jacobian (..., R, P) at a point."""

    value: Numbers
    slope: Numbers

    @property
    def cost(self) -> Numbers:
        """Half the sum of squares, (...)."""
        return (self.value**2).sum(-1) / 2

    def after(self, step: Numbers) -> Numbers:
        """Residuals of the linear model a step (..., P) away."""
        return self.value + (self.slope @ step[..., None])[..., 0]


def bounded_step(near: Linear, radius: Numbers) -> Numbers:
    """argmin |r + J d| over |d| <= radius: d = -(J^T J + mu)^-1 J^T r with the least mu >= 0 that makes it so short.

    Accuracy: length 1e-6 of the radius, gradient 1e-5, for condition numbers of J up to 1e9.
    """
    xp = namespace_of(near.slope)
    left, sizes, right = xp.linalg.svd(near.slope, full_matrices=False)
    squares, gradient = sizes**2, sizes * (near.value[..., None, :] @ left)[..., 0, :]

    def lengthened(mu: Numbers) -> tuple[Numbers, Numbers]:
        """Coordinates of the step along the right vectors, and how its squared length falls with mu, halved."""
        damped = xp.maximum(squares + mu[..., None], TINY)
        d = gradient / damped
        return d, (d * d / damped).sum(-1)

    def newton(mu: Numbers) -> Numbers:
        # 1/|d| is concave in mu: from the left its tangent never overshoots the root of 1/|d| = 1/radius
        d, fall = lengthened(mu)
        length = _length(d)
        return mu + xp.maximum((length / radius - 1) * length**2 / xp.maximum(fall, TINY), 0.0)

    d, _ = lengthened(_repeated(newton, xp.zeros_like(radius)))
    d = d * xp.minimum(1.0, radius / xp.maximum(_length(d), TINY))[..., None]
    return -(d[..., None, :] @ right)[..., 0, :]


def next_radius(radius: Numbers, step: Numbers, before: Linear, cost: Numbers) -> tuple[Numbers, Numbers]:
    """Radius after a step of the linear model ``before`` it, and whether the step is taken: unless it raises the cost.

    Args:
        cost: after the step.
    """
    xp, length = namespace_of(radius), _length(step)
    promised = before.cost - (before.after(step) ** 2).sum(-1) / 2
    gained = before.cost - cost
    longer = xp.where(gained > GOOD * promised, xp.maximum(radius, LONGER * length), radius)
    shorter = xp.where(gained >= 0, SHORTER, MUCH_SHORTER) * length
    return xp.where(gained >= POOR * promised, longer, shorter), gained >= 0  # a gain that is not a number is none


def at_rest(z: Numbers, step: Numbers, before: Linear, after: Linear, rtol: float) -> Numbers:
    """Whether neither point nor residuals moved by more than the tolerance, relative to 1 + what they are."""
    xp = namespace_of(z)
    still = (xp.abs(step) < rtol * (1 + xp.abs(z))).all(-1)
    return still & (xp.abs(after.value - before.value) < rtol * (1 + xp.abs(after.value))).all(-1)


def _repeated(step: Callable[[Numbers], Numbers], start: Numbers) -> Numbers:
    """So many Newton steps, or until nothing moves."""
    if namespace_of(start) is not np:
        return jax.lax.fori_loop(0, NEWTON_STEPS, lambda _, x: step(x), start)
    now = start
    for _ in range(NEWTON_STEPS):
        before, now = now, step(now)
        if (before == now).all():
            break
    return now


def _length(x: Numbers) -> Numbers:
    return namespace_of(x).sqrt((x * x).sum(-1))
