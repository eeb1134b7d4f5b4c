"""The model's functions as one program each: called as they are, every operation in them is a program of its own."""

from functools import partial

import jax
import numpy as np
from merlfit.model import albedo, reflectance
from merlfit.model import derived as of_derived
from merlfit.model import two_scale as of_two_scale
from merlfit.model.geometry import Geometry

evaluate = jax.jit(reflectance.evaluate, static_argnames=("model", "wavelengths_um"), inline=True)
two_scale = jax.jit(of_two_scale.two_scale, static_argnames=("model", "wavelengths_um"), inline=True)
directional_albedo = jax.jit(albedo.directional_albedo, static_argnames=("model", "wavelengths_um"))
derived = jax.jit(of_derived.derived, static_argnames=("material", "wavelengths_um"))
prepared = jax.jit(reflectance.prepared, static_argnames=("model", "wavelengths_um"))
from_vectors = jax.jit(Geometry.from_vectors, inline=True)
from_half_difference = jax.jit(Geometry.from_half_difference, inline=True)


@partial(jax.jit, static_argnums=0)
def between(model, positions):
    """Parameters at positions in [0, 1] between their bounds, by name."""
    return {q.name: q.between(positions[q.name]) for q in model.parameters}


def drawn(rng, model, channels=3):
    """A parameter set between the bounds, uniform in each parameter's own scale."""
    positions = {q.name: np.asarray(rng.uniform(size=channels if q.per_channel else None)) for q in model.parameters}
    return between(model, positions)
