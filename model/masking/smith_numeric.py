"""Smith's masking of any isotropic distribution of slopes, by quadrature: for those without a closed form.

The masking's one-dimensional integral (`masking.smith` derives it for one distribution), with mu = cot(theta) and
P22 the density of slopes s,

    Lambda = 2 Int_{s > mu} s P22(s^2) [sqrt(t^2 - 1) - arccos(1/t)] ds,    t = s / mu,

is taken in q, t = 1 + e^q, by the trapezoid rule: the integrand decays as an exponential at both ends.
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..numerics import Real, Scalar, safe_sqrt, total
from ..piecewise import interpolate

NODES = np.arange(-10.0, 36.0, 0.25)  # of q; up to slopes of 1e15 times cot(theta), as heavy tails need
TABLE_SIZE = 161  # nodes of the interpolation table
Slopes = Callable[[Array], Array]


def excess(w_minus_1: Real) -> Real:
    """``z - arctan z`` with ``z = sqrt(w^2 - 1)``, without cancellation for small z."""
    z = safe_sqrt(w_minus_1) * jnp.sqrt(2 + w_minus_1)  # the product of both may overflow in float32
    small = z < 0.03
    z_small, z_large = jnp.where(small, z, 0.0), jnp.where(small, 1.0, z)
    s = z_small**2
    series = z_small * s * (1 / 3 - s * (1 / 5 - s * (1 / 7 - s * (1 / 9 - s / 11))))
    return jnp.where(small, series, z_large - jnp.arctan(z_large))


def smith_lambda(cotangent: Real, slopes: Slopes) -> Real:
    """Smith's Lambda at cot(theta) > 0.

    Args:
        slopes: P22 at squares of slopes; its integral over the plane of slopes is one.

    Accuracy, relative: 2e-7 (``tests/rivals/test_microfacets.py``).
    """
    grown = jnp.exp(jnp.asarray(NODES, jnp.result_type(cotangent)))
    mu = cotangent[..., None]
    weighed = slopes((mu * (1 + grown)) ** 2) * (1 + grown) * excess(grown) * grown
    return 2 * cotangent**2 * total(weighed) * float(NODES[1] - NODES[0])


def G1_table(width: Scalar, slopes: Slopes) -> Real:
    """G1 = 1 / (1 + Lambda) at even steps of x = 1 / (1 + sqrt(width tan(theta))) from 0 to 1: what :func:`G1` reads.

    Args:
        width: of the distribution: a typical slope.
    """
    x = np.linspace(0.0, 1.0, TABLE_SIZE)[1:-1]
    cotangent = width * jnp.asarray((x / (1 - x)) ** 2)
    inside = 1 / (1 + smith_lambda(cotangent, slopes))
    return jnp.concatenate([jnp.zeros(1, inside.dtype), inside, jnp.ones(1, inside.dtype)])


def G1(cos: Real, width: Scalar, table: Real) -> Real:
    """Smith's masking of directions whose cosine with the normal is ``cos`` > 0."""
    root_cos = jnp.sqrt(cos)
    root_tan = safe_sqrt(width * safe_sqrt((1 - cos) * (1 + cos)))
    return interpolate(table, root_cos / (root_cos + root_tan) * (TABLE_SIZE - 1))
