"""Importance sampling: directions drawn nearly in proportion to a BRDF times cosine, a file a way.

Of a pair of directions one is ``given`` and the other is ``drawn``, both unit vectors ``(..., 3)`` in a frame whose
third axis is the normal; BRDFs are reciprocal, so which of them is the light does not matter. A :class:`Sampler` draws
by uniform numbers and knows its density; all of it is jax, to be compiled, with arrays as leaves.
"""

from typing import Protocol, runtime_checkable

from jax import Array


@runtime_checkable
class Sampler(Protocol):
    """A way to draw directions.

    Attributes:
        dimensions: uniform numbers in [0, 1) that a direction takes.
    """

    @property
    def dimensions(self) -> int: ...  # noqa: D102

    def draw(self, given: Array, u: Array) -> Array:
        """Directions ``(..., 3)`` by numbers ``u`` ``(..., dimensions)``; below the horizon where there is none."""
        ...

    def density(self, given: Array, drawn: Array) -> Array:
        """Probability a solid angle (1/sr), ``(...)``; 0 below the horizon."""
        ...
