"""Half vectors of any isotropic BRDF, tabulated from itself, and turned towards where they are seen.

A facet m is seen from a direction at theta in proportion to cos(theta) + tan(theta_m) sin(theta) cos(phi_m), phi_m
counted from that direction: what sampling of visible normals (Heitz & d'Eon 2014) draws by. Here the azimuth follows
this law in closed form, cut off where the mirrored direction sets; and theta_h follows a table of the BRDF itself, its
cosine and this cut included, by the angle of the given direction. So one mechanism serves every model and every file.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..geometry import Geometry
from ..numerics import safe_acos, safe_sqrt
from ..quadrature import gauss_legendre

CELLS = 256  # of theta_h, even in asinh(tan(theta_h) / LINEAR)
LINEAR = 2e-4  # below this tangent (0.01 degrees) they are even in it
SMALLEST = 1e-9  # tangent: the density is that of a slope, and so has a pole at 0 as a density of directions
STEEPEST = 1e3  # tangent of the largest theta_h
INCIDENCES = 48  # rows, even in theta
GRAZING = float(np.radians(89.9))  # a number of NumPy would make float64 of float32
HALF_RING = 8  # Gauss nodes of half a ring
NEWTON = 5  # steps for the azimuth: to 1e-9 where it matters
LONGEST = float(np.arcsinh(STEEPEST / LINEAR))
NOTHING = (0.0, 0.0, -1.0)  # straight down


class Visible(eqx.Module):
    """Density by theta_h from a table, by azimuth as facets are seen.

    Attributes:
        share: of each cell of theta_h, (INCIDENCES, CELLS); rows sum to one. below: the same, cumulated.
    """

    share: Array
    below: Array
    dimensions = 2

    def draw(self, given: Array, u: Array) -> Array:
        """Below the horizon only where the cell lies at the edge of what a row between two nodes can show."""
        row, t = _row(given[..., 2])
        first = u[..., 0] >= t
        row = jnp.where(first, row, row + 1)
        v = jnp.where(first, (u[..., 0] - t) / jnp.maximum(1 - t, 1e-30), u[..., 0] / jnp.maximum(t, 1e-30))
        below, share = self.below.reshape(-1), self.share.reshape(-1)
        cell = jnp.zeros_like(row)
        step = CELLS // 2
        while step:  # the last cell that begins at or below v
            cell = jnp.where(below[row * CELLS + cell + step] <= v, cell + step, cell)
            step //= 2
        place = row * CELLS + cell
        inside = jnp.clip((v - below[place]) / jnp.maximum(share[place], 1e-30), 0.0, 1.0)
        tangent = LINEAR * jnp.sinh((cell + inside) * (LONGEST / CELLS))
        cos, along, end = _ring(given[..., 2], tangent)
        turn = _azimuth(cos, along, end, 2 * u[..., 1] - 1)
        horizontal = jnp.hypot(given[..., 0], given[..., 1])
        there = horizontal > 0
        x = jnp.where(there, given[..., 0] / jnp.where(there, horizontal, 1.0), 1.0)
        y = jnp.where(there, given[..., 1] / jnp.where(there, horizontal, 1.0), 0.0)
        c, s, up = jnp.cos(turn), jnp.sin(turn), 1 / jnp.sqrt(1 + tangent**2)
        facet = jnp.stack([tangent * up * (x * c - y * s), tangent * up * (y * c + x * s), up], -1)
        return mirrored(given, facet)

    def density(self, given: Array, drawn: Array) -> Array:
        """From the table and the azimuth's law, over 4 cos_d."""
        above = drawn[..., 2] > 0
        half = given + jnp.where(above[..., None], drawn, given)
        tangent = jnp.maximum(jnp.hypot(half[..., 0], half[..., 1]) / half[..., 2], SMALLEST)
        place = jnp.arcsinh(tangent / LINEAR) * (CELLS / LONGEST)
        cell = jnp.clip(place.astype(jnp.int32), 0, CELLS - 1)
        row, t = _row(given[..., 2])
        share = self.share.reshape(-1)
        by_cell = share[row * CELLS + cell] * (1 - t) + share[(row + 1) * CELLS + cell] * t
        by_tangent = by_cell * (CELLS / LONGEST) / jnp.sqrt(tangent**2 + LINEAR**2)
        cos, along, end = _ring(given[..., 2], tangent)
        cos_d = jnp.sqrt(jnp.sum(half**2, -1)) / 2
        # cos(theta) + tan(theta_h) sin(theta) cos(phi) = cos_d / cos(theta_h), over its integral
        grown = jnp.sqrt(1 + tangent**2)
        by_azimuth = cos_d * grown / (2 * (cos * end + along * jnp.sin(end)))
        solid_angle = tangent / grown**3  # over d tangent d azimuth
        density = by_tangent * by_azimuth / (solid_angle * 4 * cos_d)
        return jnp.where(above & (end > 0) & (place < CELLS), density, 0.0)


def mirrored(given: Array, facet: Array) -> Array:
    """Where a facet of normal ``facet`` sends light; :data:`NOTHING` from its back."""
    dot = jnp.sum(given * facet, -1, keepdims=True)
    return jnp.where(dot > 0, 2 * dot * facet - given, jnp.asarray(NOTHING, facet.dtype))


def _row(cos: Array) -> tuple[Array, Array]:
    """Row of the table below an incidence, and how far it is to the next."""
    position = jnp.clip(safe_acos(cos) * ((INCIDENCES - 1) / GRAZING), 0.0, INCIDENCES - 1.0)
    row = jnp.clip(position.astype(jnp.int32), 0, INCIDENCES - 2)
    return row, position - row


def _ring(cos: Array, tangent: Array) -> tuple[Array, Array, Array]:
    """cos(theta), tan(theta_h) sin(theta), and the azimuth at which the mirrored direction sets (0: it never rises)."""
    along = tangent * safe_sqrt(1 - cos**2)
    edge = cos * (tangent**2 - 1) / 2
    level = edge / jnp.maximum(along, 1e-30)
    return cos, along, safe_acos(jnp.clip(level, -1.0, 1.0))


def _azimuth(cos: Array, along: Array, end: Array, v: Array) -> Array:
    """The azimuth whose share of cos phi + along sin phi, up to the end on either side, is v in [-1, 1]: by Newton."""
    aim = jnp.abs(v) * (cos * end + along * jnp.sin(end))
    phi = jnp.abs(v) * end
    for _ in range(NEWTON):
        sine, cosine = jnp.sin(phi), jnp.cos(phi)
        slope = jnp.maximum(cos + along * cosine, 1e-12)
        phi = jnp.clip(phi - (cos * phi + along * sine - aim) / slope, 0.0, end)
    return jnp.where(v < 0, -phi, phi)


def visible(brdf: Callable[[Geometry], Array]) -> Visible:
    """The table of a BRDF.

    Args:
        brdf: from directions, a broadcast grid with theta_h as ``(1, CELLS, 1)``, to ``(C, ...)`` (1/sr): a model's
            :func:`merlfit.model.reflectance.evaluate`, a file's values. The mean of the channels is taken.
    """
    tangent = LINEAR * np.sinh((np.arange(CELLS) + 0.5) * (LONGEST / CELLS))[:, None]
    theta = np.linspace(0, GRAZING, INCIDENCES)[:, None, None]
    cos = jnp.asarray(np.cos(theta))
    _, along, end = _ring(cos, jnp.asarray(tangent))
    u, w = gauss_legendre(HALF_RING)
    phi = end * u
    grown = np.sqrt(1 + tangent**2)
    cos_d = jnp.clip((cos + along * jnp.cos(phi)) / grown, 0.0, 1.0)
    cos_o = 2 * cos_d / grown - cos
    seen = (cos_o > 0) & (end > 0)
    safe = [jnp.where(seen, x, 1.0) for x in (cos_d, cos_o)]
    shape = seen.shape
    g = Geometry(jnp.arctan(jnp.asarray(tangent))[None], safe_acos(safe[0]), jnp.broadcast_to(cos, shape), safe[1])
    values = jnp.mean(brdf(g), 0)
    # solid angle of half vectors a cell, and 4 cos_d from there to directions
    measure = tangent * np.sqrt(tangent**2 + LINEAR**2) / grown**3
    light = jnp.where(seen, jnp.maximum(values, 0.0) * safe[1] * 4 * safe[0] * measure * end * w, 0.0)
    share = jnp.sum(light, -1)
    share = jnp.where(jnp.sum(share, -1, keepdims=True) > 0, share, jnp.any(seen, -1) * measure[:, 0])
    share = share / jnp.sum(share, -1, keepdims=True)
    return Visible(share, jnp.cumsum(share, -1) - share)
