"""Directions as a table of scattered ones has them, a third of them about the mirror's."""

import jax.numpy as jnp
import numpy as np
from merlfit.model.geometry import Geometry


def directions(count, seed=0):
    """Geometry (count,) and the arrays of a table without its values; both directions within 75 degrees."""
    rng = np.random.default_rng(seed)
    theta_i, theta_o = np.arccos(rng.uniform(0.26, 1, (2, count)))
    phi = rng.uniform(0, 360, count)
    third = slice(0, count // 3)
    theta_o[third] = np.clip(theta_i[third] + rng.normal(0, 0.08, count // 3), 0, 1.3)
    phi[third] = 180 + rng.normal(0, 6, count // 3)
    arrays = {
        "theta_i_deg": np.degrees(theta_i), "theta_o_deg": np.degrees(theta_o), "phi_deg": phi,
        "wavelengths_um": np.array([0.645, 0.526, 0.444]),
    }  # fmt: skip
    i = np.stack([np.sin(theta_i), 0 * theta_i, np.cos(theta_i)], -1)
    o = np.stack([np.sin(theta_o) * np.cos(np.radians(phi)), np.sin(theta_o) * np.sin(np.radians(phi)),
                  np.cos(theta_o)], -1)  # fmt: skip
    h = (i + o) / np.linalg.norm(i + o, axis=-1, keepdims=True)
    theta_h, theta_d = np.arccos(h[:, 2]), np.arccos(np.clip(np.sum(h * i, -1), -1, 1))
    return Geometry(*map(jnp.asarray, (theta_h, theta_d, i[:, 2], o[:, 2]))), arrays
