"""A material as tables for other renderers: its BRDF over half and difference angles, and how to draw directions."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..merl_io.atomic import write_atomically
from ..model.geometry import Geometry
from ..model.sampling.visible import CELLS, LINEAR, LONGEST
from .surface import Material, facets_of

DIFFERENCES, AZIMUTHS = 90, 45  # nodes of theta_d and of phi_d, each at the middle of its cell of 1 and 2 degrees
DARKEST = 1e-9  # BRDF (1/sr) of which the logarithm is taken


def tables(material: Material) -> dict[str, np.ndarray]:
    """Arrays of 32 bits by name.

    ``brdf``, (CELLS, DIFFERENCES, AZIMUTHS, 4): at theta_h even in asinh(tan(theta_h) / LINEAR), theta_d and phi_d in
    [0, 90] degrees the logarithm of the BRDF in R, G and B, times whether light and viewer are above the surface, and
    that (1 or 0): a sum over nodes divided by that of the last number leaves out what is not there. ``share`` and
    ``below``: those of :class:`merlfit.model.sampling.visible.Visible`.
    """
    found = facets_of(material.brdf)
    return {
        "brdf": np.asarray(_brdf(material), np.float32),
        "share": np.asarray(found.share, np.float32),
        "below": np.asarray(found.below, np.float32),
    }


@eqx.filter_jit
def _brdf(material: Material) -> Array:
    tangent = LINEAR * jnp.sinh((jnp.arange(CELLS) + 0.5) * (LONGEST / CELLS))
    theta_d, phi_d = ((jnp.arange(n) + 0.5) * (jnp.pi / 2 / n) for n in (DIFFERENCES, AZIMUTHS))
    g = Geometry.from_half_difference(jnp.arctan(tangent)[:, None, None], theta_d[None, :, None], phi_d[None, None])
    above = (g.cos_i > 0) & (g.cos_o > 0)
    logs = jnp.moveaxis(jnp.log(jnp.maximum(material.brdf(g), DARKEST)), 0, -1)
    return jnp.concatenate([jnp.where(above[..., None], logs, 0.0), above[..., None].astype(logs.dtype)], -1)


def write_tables(path: Path, material: Material) -> None:
    """As .npz, compressed, atomically."""
    found = tables(material)
    write_atomically(
        path, lambda file: np.savez_compressed(file, brdf=found["brdf"], share=found["share"], below=found["below"])
    )
