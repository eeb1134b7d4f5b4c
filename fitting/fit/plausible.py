"""Whether values of the two-scale model, or of a sum over it, may be those of matter, in sentences for users."""

from collections.abc import Mapping, Sequence

import numpy as np

from ...model.reflectance import Reflectance
from ...model.sum import lowest
from ...model.two_scale import TwoScale

METALS_N, METALS_K = (0.02, 4.5), (1.3, 8.5)  # of metals in visible light, from silver and gold to tungsten, rhodium
METAL_FLOOR = 0.05  # albedo under a complex index: stray light and dust on a metal are less
BRIGHT = 0.08  # albedo under a complex index that dust explains no more: a choice goes by it, cautions by the floor
LEAST_K = 0.2  # in some channel: what absorbs less is a dielectric (the darkest metal of a photograph has 0.4)
SILVERY = 0.1, 2.0  # an n below the first is silver's, whose k is above the second (Johnson & Christy 1972)


def cautions(
    material: Reflectance, v: Mapping[str, np.ndarray], channels: Sequence[str], wavelengths_um: Sequence[float]
) -> list[str]:
    """What to know of them; nothing where there is nothing to doubt, and of other models.

    Args:
        v: by parameter, (1,), or (C,) for those per channel. channels: their names. wavelengths_um: theirs.
    """
    found = []
    if not isinstance(lowest(material), TwoScale):
        return found
    if float(np.max(v.get("sigma_s", np.zeros(1)))) > min(wavelengths_um) / 2:
        found.append(
            "sigma_s is more than half a wavelength: nearly all light is diffracted, and its value is uncertain"
        )
    if "film_eta" in v:
        said = "n, k, index and thickness of the film are effective values: the hue gives the optical path alone well"
        return [*found, said]
    return found + (_of_no_metal(v, channels) if "k" in v else [])


def of_matter(material: Reflectance, v: Mapping[str, np.ndarray]) -> bool:
    """Whether some matter may have these constants, if its photograph has any scale: what a choice goes by.

    Metals of photographs are up to ten times too dark, so that their n and k lie far from the tables' (`cautions` says
    so), but they are no bright bodies, they absorb, and only the best mirrors have an n near 0. Under a film there may
    be anything.
    """
    base = lowest(material)
    if "k" not in v or not isinstance(base, TwoScale) or base.index == "film":
        return True
    n, k = np.atleast_1d(v["n"]), np.atleast_1d(v["k"])
    floor = float(np.max(v.get("albedo", np.zeros(1))))
    return bool(floor <= BRIGHT and np.max(k) >= LEAST_K and np.all((n >= SILVERY[0]) | (k >= SILVERY[1])))


def _of_no_metal(v: Mapping[str, np.ndarray], channels: Sequence[str]) -> list[str]:
    """Why the optical constants, or the floor under them, are not those of a metal; nothing if they may be."""
    effective = "n and k are effective values, not those of a material"
    if float(np.max(v.get("albedo", np.zeros(1)))) > METAL_FLOOR:
        return [f"a body this bright lies under no metal: {effective}"]
    for channel, n, k in zip(channels, v["n"], v["k"], strict=True):
        if not (METALS_N[0] <= n <= METALS_N[1] and METALS_K[0] <= k <= METALS_K[1]):
            return [f"no metal has n {n:.2g} with k {k:.2g} ({channel}): {effective}"]
    return []
