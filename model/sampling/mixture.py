"""One of several ways, chosen by chance: their densities add up, so that no weight exceeds by much that of the best."""

from functools import reduce
from operator import add

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from . import Sampler


class Mixture(eqx.Module):
    """Ways and their shares, which may depend on the cosine of the given direction with the normal.

    Attributes:
        parts: the ways, (K). shares: of them, (K,), or (K, N) at even steps of the cosine from 0 to 1, linear between;
            each column sums to one.
    """

    parts: tuple[Sampler, ...]
    shares: Array

    @property
    def dimensions(self) -> int:
        """One to choose by, and those of the parts."""
        return 1 + max(part.dimensions for part in self.parts)

    def draw(self, given: Array, u: Array) -> Array:
        """Of the part that the first number chooses."""
        below, drawn = jnp.zeros_like(u[..., 0]), jnp.broadcast_to(given, (*u.shape[:-1], 3))
        for part, share in zip(self.parts, self._shares(given), strict=True):
            chosen = (u[..., 0] >= below) & (u[..., 0] < below + share)
            drawn = jnp.where(chosen[..., None], part.draw(given, u[..., 1 : 1 + part.dimensions]), drawn)
            below = below + share
        return drawn

    def density(self, given: Array, drawn: Array) -> Array:
        """Sum of shares times densities."""
        each = [share * part.density(given, drawn) for part, share in zip(self.parts, self._shares(given), strict=True)]
        return reduce(add, each)

    def _shares(self, given: Array) -> Array:
        """(K, ...) at the given directions; rounding leaves the last part what is missing to one."""
        if self.shares.ndim == 1:
            found = self.shares.reshape(-1, *(1,) * (given.ndim - 1))
        else:
            position = jnp.clip(given[..., 2], 0.0, 1.0) * (self.shares.shape[1] - 1)
            cell = jnp.clip(position.astype(jnp.int32), 0, self.shares.shape[1] - 2)
            t = position - cell
            found = self.shares[:, cell] * (1 - t) + self.shares[:, cell + 1] * t
        return jnp.concatenate([found[:-1], 1 - jnp.sum(found[:-1], 0, keepdims=True)])
