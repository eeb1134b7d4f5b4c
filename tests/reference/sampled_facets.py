"""Interfaced Lambertian facets by Monte Carlo (IL Section 3.3 and 4.1): anisotropic normals, and light between facets.

What has no sum over few normals: a body whose normals depend on the azimuth, by drawing facets (:func:`body`), and
light that is reflected again and again within V-cavities, by following paths (:func:`paths`). Both are references, with
the error of their own samples; no fit uses them.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from merlfit.model.body import external_diffuse_reflectance, internal_diffuse_reflectance, substrate
from merlfit.model.fresnel import fresnel_of_dielectric
from merlfit.model.ndf import beckmann, ggx
from merlfit.model.numerics import safe_sqrt

NormalsName = Literal["beckmann", "ggx", "gaussian"]
Smooth = Literal["beckmann", "ggx"]  # those that Smith's masking leaves something of
LEAST_COSINE = 1e-9
FLIP = np.array([-1.0, 1.0, 1.0])


class Estimate(NamedTuple):
    """A mean and its standard error."""

    mean: Array
    error: Array


def draw_normals(key: Array, count: int, roughness: tuple[float, float], normals: NormalsName) -> Array:
    """Normals of facets with density D(m) cos(theta_m), (count, 3).

    Slopes along x and y have the roughness along it times those of an isotropic surface of roughness 1, which is IL Eq.
    29-31 without the quadrants that its arctan loses. Gaussian slope angles (IL Eq. 13) are isotropic alone.

    Raises:
        ValueError: Gaussian normals of two different roughnesses.
    """
    if normals == "gaussian" and roughness[0] != roughness[1]:
        raise ValueError("normals 'gaussian' are isotropic: give the same roughness twice")
    u, v = jax.random.uniform(key, (2, count))
    azimuth = 2 * jnp.pi * v
    if normals == "gaussian":
        tangent = _gaussian_slope(u, roughness[0])
        return _normals(tangent, tangent, azimuth)
    radius = jnp.sqrt(-jnp.log1p(-u) if normals == "beckmann" else u / (1 - u))
    return _normals(roughness[0] * radius, roughness[1] * radius, azimuth)


def _normals(along_x: Array, along_y: Array, azimuth: Array) -> Array:
    """Unit normals (N, 3) of facets whose slopes are these times the cosine and the sine of the azimuth."""
    up = jnp.stack([-along_x * jnp.cos(azimuth), -along_y * jnp.sin(azimuth), jnp.ones_like(azimuth)], -1)
    return up / jnp.linalg.norm(up, axis=-1, keepdims=True)


def _gaussian_slope(u: Array, sigma: float) -> Array:
    """Tangents of slope angles whose share of the projected area is u, from a table of the cumulated density."""
    angle = jnp.linspace(0.0, min(8 * sigma, jnp.pi / 2), 20_001)
    middle = (angle[1:] + angle[:-1]) / 2
    below = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.exp(-((middle / sigma) ** 2) / 2) * jnp.sin(middle))])
    return jnp.tan(jnp.interp(u, below / below[-1], angle))


def masked(direction: Array, roughness: tuple[float, float], normals: Smooth) -> Array:
    """Smith's G1 of one direction (IL Eq. 19, 21): that of an isotropic surface of the roughness along it."""
    tan = safe_sqrt((roughness[0] * direction[0]) ** 2 + (roughness[1] * direction[1]) ** 2)
    cos = direction[2] / jnp.sqrt(direction[2] ** 2 + tan**2)
    return (beckmann if normals == "beckmann" else ggx).G1(cos, jnp.ones(()))


def body(
    key: Array, i: ArrayLike, o: ArrayLike, roughness: tuple[float, float], index: ArrayLike, albedo: ArrayLike,
    normals: Smooth = "beckmann", count: int = 100_000,
) -> Estimate:  # fmt: skip
    """Body of interfaced Lambertian facets (IL Eq. 12) with Smith's masking, from facets that are drawn.

    By their projected area with Beckmann's normals; with GGX evenly in psi, tan(theta_m) = alpha tan(psi), since the
    variance would be infinite by area.

    Args:
        i, o: unit vectors (3,), above the surface. roughness: along x and y. index: real, scalar. albedo: of the
            substrate. count: of facets.

    Returns: BRDF (1/sr) and its standard error.

    Raises:
        ValueError: Smith's masking of these normals is 0.
    """
    if normals not in ("beckmann", "ggx"):
        raise ValueError(f"Smith's masking of {normals!r} normals is 0: choose 'beckmann' or 'ggx'")
    i, o, n, albedo = (jnp.asarray(x, float) for x in (i, o, index, albedo))
    if normals == "ggx":
        psi, turn = jax.random.uniform(key, (2, count)) * jnp.array([[jnp.pi / 2], [2 * jnp.pi]])
        m = _normals(roughness[0] * jnp.tan(psi), roughness[1] * jnp.tan(psi), turn)
        weight = jnp.pi / 2 * jnp.sin(2 * psi)
    else:
        m, weight = draw_normals(key, count, roughness, normals), jnp.ones(count)
    dots = [jnp.clip(m @ x, 0.0, 1.0) for x in (i, o)]
    through = [dot * (1 - fresnel_of_dielectric(dot, n)) for dot in dots]
    each = weight * through[0] * through[1] / (m[:, 2] * i[2] * o[2])
    scale = (
        substrate(n, albedo, internal_diffuse_reflectance(n))
        * masked(i, roughness, normals)
        * masked(o, roughness, normals)
    )
    return Estimate(scale * each.mean(), scale * each.std() / jnp.sqrt(count))


class Paths(NamedTuple):
    """Light that left V-cavities: directions (N, 3), what share of the light each path carries, bounces (N,).

    Paths that had to be given up have share 0; ``caught`` is what they carried, summed over N.
    """

    direction: Array
    share: Array
    bounces: Array
    caught: Array


def paths(
    key: Array, i: ArrayLike, roughness: tuple[float, float], index: float, albedo: float, count: int,
    normals: NormalsName = "beckmann", most: int = 40,
) -> Paths:  # fmt: skip
    """Light from direction i through symmetric V-cavities of interfaced Lambertian facets, all bounces (IL Eq. 22).

    A cavity is drawn by its projected area and a point of its opening evenly, so that every path falls on a facet and
    none is lost: shadowing and masking come by themselves. A facet reflects as a mirror with probability F; else light
    enters the substrate, comes out again with the share that IL Eq. 8 gives, and goes where transmittance lets it.
    Profiles have their bottom at 0 and facets of length 1; the facet a path is on is the one whose normal points to +x.

    Args:
        i: unit vector (3,) above the surface. roughness: along x and y. index, albedo: as in :func:`body`. count: of
            paths. most: bounces after which a path is given up.

    Raises:
        ValueError: Gaussian normals of two different roughnesses.
    """
    keys = jax.random.split(key, 3)
    m = draw_normals(keys[0], count, roughness, normals)
    sine, cosine = jnp.maximum(safe_sqrt(1 - m[:, 2] ** 2), LEAST_COSINE), m[:, 2]
    x, y = m[:, 0] / sine, m[:, 1] / sine  # the profile's axis
    i = jnp.asarray(i, float)
    towards = -jnp.stack([i[0] * x + i[1] * y, i[1] * x - i[0] * y, jnp.full(count, i[2])], -1)
    opening = (2 * jax.random.uniform(keys[1], (count,)) - 1) * cosine
    profile = jnp.stack([sine, jnp.zeros(count), cosine], -1)
    start = _Flight(
        *_entered(profile, towards, opening), jnp.ones(count), jnp.zeros(count, int), jnp.zeros(count, bool)
    )
    n, albedo_ = jnp.asarray(index, float), jnp.asarray(albedo, float)
    step = lambda flight, key: (_bounced(key, flight, profile, n, albedo_), None)  # noqa: E731
    end, _ = jax.lax.scan(step, start, jax.random.split(keys[2], most))
    out = jnp.where(end.mirrored[:, None], end.direction * FLIP, end.direction)
    back = [out[:, 0] * x - out[:, 1] * y, out[:, 0] * y + out[:, 1] * x, out[:, 2]]
    left = jnp.where(end.done, end.share, 0.0)
    return Paths(jnp.stack(back, -1), left, end.bounces, jnp.sum(end.share - left))


class _Flight(NamedTuple):
    """Where paths are: place on the facet in (0, 1], direction in the frame in which its normal points to +x."""

    place: Array
    direction: Array
    mirrored: Array  # whether that frame's x-axis is turned round
    share: Array
    bounces: Array
    done: Array


def _entered(normal: Array, towards: Array, opening: Array) -> tuple[Array, Array, Array]:
    """Place, direction and frame of the facet that light through points of the opening meets first."""
    sine, cosine = normal[:, 0], normal[:, 2]

    def meets(direction: Array, x: Array) -> tuple[Array, Array]:
        """Distance along the ray to the facet's line, infinite from behind, and the place on the facet."""
        against = -jnp.sum(direction * normal, -1)
        distance = jnp.where(against > 0, sine * (cosine + x) / jnp.maximum(against, LEAST_COSINE), jnp.inf)
        return distance, 1 + distance * direction[:, 2] / sine

    (left, on_left), (right, on_right) = meets(towards, opening), meets(towards * FLIP, -opening)
    mirrored = right < left
    place = jnp.clip(jnp.where(mirrored, on_right, on_left), LEAST_COSINE, 1.0)
    return place, jnp.where(mirrored[:, None], towards * FLIP, towards), mirrored


def _bounced(key: Array, f: _Flight, normal: Array, n: Array, albedo: Array) -> _Flight:
    """After one more reflection: on the other facet, or out."""
    choice, u, v = jax.random.uniform(key, (3, len(f.place)))
    sine, cosine = normal[:, 0], normal[:, 2]
    facing = jnp.clip(-jnp.sum(f.direction * normal, -1), 0.0, 1.0)
    specular = choice < fresnel_of_dielectric(facing, n)
    mirror = f.direction + 2 * facing[:, None] * normal
    cos, sin, azimuth = jnp.sqrt(u), jnp.sqrt(1 - u), 2 * jnp.pi * v
    across, along = sin * jnp.cos(azimuth), sin * jnp.sin(azimuth)
    scattered = cos[:, None] * normal + jnp.stack([across * cosine, along, -across * sine], -1)
    goes = jnp.where(specular[:, None], mirror, scattered)
    r_i = internal_diffuse_reflectance(n)
    kept = albedo * (1 - r_i) / (1 - r_i * albedo)  # of what entered; it leaves in proportion to transmittance
    leaves = kept * (1 - fresnel_of_dielectric(cos, n)) / (1 - external_diffuse_reflectance(n))
    away = sine * goes[:, 0] - cosine * goes[:, 2]
    there = f.place * jnp.sum(goes * normal, -1) / jnp.where(away > 0, away, 1.0)
    hits, on = (away > 0) & (there <= 1), ~f.done
    return _Flight(
        jnp.where(on & hits, jnp.maximum(there, LEAST_COSINE), f.place),
        jnp.where(on[:, None], jnp.where(hits[:, None], goes * FLIP, goes), f.direction),
        jnp.where(on & hits, ~f.mirrored, f.mirrored),
        jnp.where(on, f.share * jnp.where(specular, 1.0, leaves), f.share),
        f.bounces + on,
        f.done | ~hits,
    )


def on_sensor(found: Paths, towards: ArrayLike, half_angle: float, bounces: tuple[int, int] = (1, 10**6)) -> Estimate:
    """Mean BRDF (1/sr) within a cone about a direction, of paths with so many bounces, and its error.

    IL Eq. 23 without its factor D(m_j), which has no place where facets were drawn by it.

    Args:
        towards: axis of the cone, unit vector (3,). half_angle: of the cone (rad). bounces: least and most.
    """
    inside = found.direction @ jnp.asarray(towards) >= jnp.cos(half_angle)
    counted = inside & (found.bounces >= bounces[0]) & (found.bounces <= bounces[1]) & (found.direction[:, 2] > 0)
    each = jnp.where(counted, found.share / jnp.maximum(found.direction[:, 2], LEAST_COSINE), 0.0)
    each = each / (2 * jnp.pi * (1 - jnp.cos(half_angle)))
    return Estimate(each.mean(), each.std() / jnp.sqrt(len(each)))
