"""What is wide: by the cosine with the normal."""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ..numerics import safe_sqrt


class Cosine(eqx.Module):
    """Density cos / pi. For a Lambertian body the weight BRDF cos / density is the albedo, whatever is drawn.

    HP15 5.1 and 5.5 draw their diffraction lobe so, IL 4.1 the light from below its facets.
    """

    dimensions = 2

    def draw(self, given: Array, u: Array) -> Array:
        """As in :class:`merlfit.model.sampling.Sampler`, like all methods of this name."""
        radius, turn = jnp.sqrt(u[..., 0]), 2 * jnp.pi * u[..., 1]
        across = (radius * jnp.cos(turn), radius * jnp.sin(turn))
        return jnp.stack([*across, safe_sqrt(1 - u[..., 0])], -1) + jnp.zeros_like(given)

    def density(self, given: Array, drawn: Array) -> Array:
        """The cosine over pi."""
        return jnp.maximum(drawn[..., 2], 0.0) / jnp.pi + jnp.zeros_like(given[..., 2])
