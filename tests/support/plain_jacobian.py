"""Normal equations the plain way, from the whole Jacobian: what `residuals.normal_equations` must equal."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.fitting.fit import problem as problems
from merlfit.fitting.fit.residuals import _predict


def plain(layout, z, samples):
    """Normal equations of all bins of the samples, from the whole Jacobian."""
    where = problems.directions(samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o, samples.bands)
    root = np.sqrt(samples.weight / problems.energy(samples))

    def predicted(z):
        return _predict(layout.model, layout.values(z), where)

    def rows(x):
        return np.moveaxis(np.asarray(x), 1, 0).reshape(root.shape + x.shape[5:])

    @partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
    def slopes(z):
        along = jax.linearize(predicted, z)[1]
        return jnp.moveaxis(jax.lax.map(along, jnp.eye(len(z))), 0, -1)  # a loop compiles in a third of the time

    jacobian = root[..., None] * rows(slopes(z))
    both = np.concatenate([jacobian, (root * (samples.value - rows(predicted(z))))[..., None]], -1)
    both = both.reshape(len(samples.bands), -1, len(z) + 1)
    return np.einsum("cnk,cnl->ckl", both, both)


def difference(found, expected):
    """Largest, relative to the diagonals."""
    scale = np.sqrt(np.einsum("ckk,cll->ckl", expected, expected)) + 1e-300
    return np.max(np.abs(found - expected) / scale)
