"""What glTF 2.0, OpenPBR and Mitsuba's `principled` draw, by their own formulas, and which parameters look nearest.

glTF: specification 2.0.1, Appendix B: "Metals" (B.2.1), "Dielectrics" (B.2.2), "Specular BRDF" (B.3.2: D, and masking
in its separable form; the text of December 2025 and the Khronos renderer have the height-correlated one), "Fresnel"
(B.3.4); its index of refraction by KHR_materials_ior. OpenPBR: specification 1.1, sections "Microfacet model" (GGX,
Smith's masking), "Dielectric base" (Fresnel's exact factor), "Metal" (F82-tint, which with a white ``specular_color``
is Schlick's factor) and "Layering" (albedo-scaling: the diffuse slab weighed by one minus the albedo of the gloss above
it). Mitsuba 3: "Principled BSDF" of its documentation, after Burley 2012 and 2015: Fresnel's exact factor of a
dielectric, Schlick's of a metal, separable masking. None with light of several bounces between facets, which some
renderers add: rough metals are brighter there.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csr_array

from ...merl_io.binary import DIMS
from ...merl_io.grid import merl_grid
from ...scene.colour import cielab
from ...scene.spheres import PIXELS, compared, render

LARGEST_IOR = 3.0  # of a dielectric; what reflects more is a metal
ROUGHNESSES, IORS = np.linspace(0.05, 1.0, 14), (1.0, 1.2, 1.5, 2.0, LARGEST_IOR)
LEAST_ROUGHNESS = 0.01
NODES = 48  # of an albedo: cosines of the viewer, and facets by slope and by azimuth


class Angles(NamedTuple):
    """Cosines of light, viewer, half vector (to the normal), and of light to half vector, of any shape."""

    i: np.ndarray
    o: np.ndarray
    h: np.ndarray
    d: np.ndarray


Brdf = tuple[np.ndarray, np.ndarray]
"""A BRDF (1/sr) that is linear in the base colour: its slope, and the rest."""
Format = Callable[[Angles, float, float | None], Brdf]
"""From angles, roughness and index of refraction (None: a metal)."""


def gltf(a: Angles, roughness: float, ior: float | None) -> Brdf:
    """glTF 2.0: ``specular_brdf`` of B.3.2, in ``metal_brdf`` of B.2.1 or in ``dielectric_brdf`` of B.2.2."""
    facets = _separable(a, roughness**4)
    if ior is None:
        return _metal(facets, a.d)
    f0 = ((1 - ior) / (1 + ior)) ** 2
    fresnel = f0 + (1 - f0) * (1 - a.d) ** 5
    return (1 - fresnel) / np.pi, fresnel * facets


def openpbr(a: Angles, roughness: float, ior: float | None) -> Brdf:
    """OpenPBR 1.1 with ``specular_weight`` 1 and without diffuse roughness.

    The albedo of the gloss is that towards the viewer; of a pair whose light and viewer are not told apart, as in
    MERL's folded bins, the mean of both.
    """
    facets = _ggx(a.h, roughness**4) * _correlated(a.i, a.o, roughness**4)
    if ior is None:
        return _metal(facets, a.d)
    cosines, found = gloss_albedo(roughness, ior)
    above = 1 - (np.interp(a.i, cosines, found) + np.interp(a.o, cosines, found)) / 2
    return above / np.pi, fresnel_dielectric(a.d, ior) * facets


def principled(a: Angles, roughness: float, ior: float | None) -> Brdf:
    """Mitsuba 3's plugin without tints, sheen, flatness and clear coat; its `eta` is the index."""
    facets = _separable(a, roughness**4)
    if ior is None:
        return _metal(facets, a.d)
    light, viewer = ((1 - x) ** 5 for x in (a.i, a.o))
    retro = 2 * roughness * a.d**2
    body = (1 - light / 2) * (1 - viewer / 2) + retro * (light + viewer + light * viewer * (retro - 1))
    return body / np.pi, fresnel_dielectric(a.d, ior) * facets


FORMATS: dict[str, Format] = {"gltf": gltf, "openpbr": openpbr, "blender": openpbr, "principled": principled}


def _metal(facets: np.ndarray, cos_d: np.ndarray) -> Brdf:
    """Schlick's factor with the base colour at normal incidence."""
    grazing = (1 - cos_d) ** 5
    return facets * (1 - grazing), facets * grazing


def _separable(a: Angles, alpha2: float) -> np.ndarray:
    """GGX facets with Smith's masking of light and viewer each by itself, over 4 cos_i cos_o."""
    masked = [x + np.sqrt(alpha2 + (1 - alpha2) * x**2) for x in (a.i, a.o)]
    return _ggx(a.h, alpha2) / (masked[0] * masked[1])


def _ggx(cos_h: np.ndarray, alpha2: float) -> np.ndarray:
    return alpha2 / (np.pi * (1 - (1 - alpha2) * cos_h**2) ** 2)


def _correlated(cos_i: np.ndarray, cos_o: np.ndarray, alpha2: float) -> np.ndarray:
    """Smith's masking of light and viewer together over 4 cos_i cos_o (Heitz 2014, Eq. 99)."""
    one, other = (x * np.sqrt(alpha2 + (1 - alpha2) * y**2) for x, y in ((cos_i, cos_o), (cos_o, cos_i)))
    return 0.5 / np.maximum(one + other, 1e-12)


def fresnel_dielectric(cos: np.ndarray, ior: float) -> np.ndarray:
    """Reflectance of unpolarised light from outside."""
    if ior == 1:
        return np.zeros_like(cos)
    inside = np.sqrt(ior**2 - 1 + cos**2)
    s, p = (cos - inside) / (cos + inside), (ior**2 * cos - inside) / (ior**2 * cos + inside)
    return (s**2 + p**2) / 2


def gloss_albedo(roughness: float, ior: float) -> tuple[np.ndarray, np.ndarray]:
    """Cosines of the viewer, and the share of light that dielectric facets reflect towards there.

    Facets are drawn by D cos_h on midpoints; to 2e-3 (tests/fitting/test_formats.py).
    """
    alpha2 = roughness**4
    u = (np.arange(NODES) + 0.5) / NODES
    o = u[:, None, None]
    h = np.sqrt((1 - u) / (1 - (1 - alpha2) * u))[:, None]
    d = o * h + np.sqrt((1 - o**2) * (1 - h**2)) * np.cos(np.pi * u)
    i = 2 * d * h - o
    seen = 4 * fresnel_dielectric(np.clip(d, 0, 1), ior) * _correlated(np.maximum(i, 0), o, alpha2) * i * d / h
    return u, np.mean(np.where((i > 0) & (d > 0), seen, 0.0), (1, 2))


@cache
def _looked_at() -> tuple[np.ndarray, Angles, list[csr_array]]:
    """The folded bins that pictures look at, their angles, and pixels of both spheres as sums over these bins."""
    spheres = [compared(lighting) for lighting in PIXELS]
    bins = np.unique(np.concatenate([pixels.indices for pixels in spheres]))
    grid, half = merl_grid(), DIMS[2] // 2
    i, o = (np.clip(x[..., :half], 0, 1) for x in (grid.cos_i, grid.cos_o))  # below the horizon that of the horizon
    h, d = (np.broadcast_to(x, i.shape) for x in (np.cos(grid.theta_h)[:, None, None], np.cos(grid.theta_d)[:, None]))
    return bins, Angles(*(x.ravel()[bins] for x in (i, o, h, d))), [pixels[:, bins] for pixels in spheres]


def nearest(values: np.ndarray, to: str, metal: bool = False) -> dict[str, Any]:
    """The parameters of a format whose spheres differ the least from a material's, and by how much.

    Args:
        values: BRDF on MERL's grid (3, 90, 90, 180), 1/sr, NaN where there is none. metal: whether it is known to be
            one; else it becomes whichever is nearer.
    """
    draw, seen, target = FORMATS[to], *_pictures(values)
    kinds = [_search(seen, target, draw, kind) for kind in ((True,) if metal else (True, False))]
    distance, roughness, ior, base = min(kinds, key=lambda kind: kind[0])
    return {
        "base_color": base.tolist(), "metallic": float(ior is None), "roughness": roughness,
        "ior": 1.5 if ior is None else ior, "error": {"cielab": distance},
    }  # fmt: skip


def apart(values: np.ndarray, to: str, base: list[float], metallic: float, roughness: float, ior: float) -> float:
    """Mean CIELAB distance of spheres between a material, as of :func:`nearest`, and given parameters of a format."""
    seen, target = _pictures(values)
    _, angles, spheres = _looked_at()
    slope, rest = (
        metallic * metal + (1 - metallic) * body
        for metal, body in zip(*(FORMATS[to](angles, roughness, n) for n in (None, ior)), strict=True)
    )
    drawn = np.where(seen, np.array(base)[:, None] * slope + rest, 0.0)
    return _distance([cielab(render(pixels, drawn)) for pixels in spheres], target)


def _pictures(values: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Which of the bins that pictures look at have values, and pixels of both spheres."""
    half = DIMS[2] // 2
    ours = (values[..., :half] + values[..., : half - 1 : -1]) / 2
    bins, _, spheres = _looked_at()
    seen = np.isfinite(ours).all(0).ravel()[bins]
    planes = np.where(seen, ours.reshape(3, -1)[:, bins], 0.0)
    return seen, [cielab(render(pixels, planes)) for pixels in spheres]


def _distance(drawn: list[np.ndarray], target: list[np.ndarray]) -> float:
    return float(np.mean([np.linalg.norm(a - b, axis=-1).mean() for a, b in zip(drawn, target, strict=True)]))


def _search(
    seen: np.ndarray, target: list[np.ndarray], draw: Format, metal: bool
) -> tuple[float, float, float | None, np.ndarray]:
    """Mean CIELAB distance, roughness, index and base colour: the best node of a grid, and from there downhill.

    A picture is linear in the base colour, which is found for each roughness and index by itself.
    """
    _, angles, spheres = _looked_at()

    def attempt(at: np.ndarray) -> tuple[float, np.ndarray]:
        parts = [np.where(seen, x, 0.0) for x in draw(angles, float(at[0]), None if metal else float(at[1]))]
        lit = [render(pixels, np.stack(parts)) for pixels in spheres]

        def off(base: np.ndarray) -> float:
            return _distance([cielab(p[:, :1] * base + p[:, 1:]) for p in lit], target)

        found = minimize(off, start["base"], bounds=[(0, 1)] * 3, method="L-BFGS-B")
        return float(found.fun), found.x

    start = {"base": np.full(3, 0.5)}
    nodes = [(r, ior) for r in ROUGHNESSES for ior in ((1.5,) if metal else IORS)]
    first = min(nodes, key=lambda node: attempt(np.array(node))[0])
    start["base"] = attempt(np.array(first))[1]
    free = 1 if metal else 2
    least = minimize(
        lambda at: attempt(at)[0], first[:free], method="Nelder-Mead",
        bounds=[(LEAST_ROUGHNESS, 1.0), (1.0, LARGEST_IOR)][:free], options={"xatol": 1e-3, "fatol": 1e-3},
    )  # fmt: skip
    off, base = attempt(least.x)
    return off, float(least.x[0]), None if metal else float(least.x[1]), base
