"""What a set of parameters comes to: quantities that mean the same whatever the parameters behind them."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from . import diffraction
from .fresnel import fresnel
from .parameters import WAVELENGTHS_UM
from .reflectance import Reflectance, Wavelengths
from .two_scale import TwoScale


class Quantity(NamedTuple):
    """A derived quantity: its key, what it is, its unit, whether it has one value per channel."""

    name: str
    meaning: str
    unit: str
    per_channel: bool


LOBE = Quantity("lobe_half_width", "half width at half maximum of the distribution of the facets' slopes", "deg", False)
DIFFRACTED = Quantity("diffracted_fraction", "share of a facet's reflection at normal incidence", "1", True)
F0 = Quantity("f0", "Fresnel reflectance at normal incidence", "1", True)


def quantities(material: Reflectance) -> tuple[Quantity, ...]:
    """Those that a material has; of other models than the two-scale one none."""
    if not isinstance(material, TwoScale):
        return ()
    return (LOBE, *((DIFFRACTED,) if material.diffraction != "off" else ()), F0)


def derived(
    values: Mapping[str, ArrayLike], material: Reflectance, wavelengths_um: Wavelengths = WAVELENGTHS_UM
) -> dict[str, Array]:
    """Derived quantities by name, scalars and (C,) for those per channel; of the material, without the apparatus.

    - lobe_half_width (degrees): arctan(beta (ln 2)^(1 / 2p)), where exp(-(tan/beta)^(2p)) of HP17 Eq. 35 is a half.
    - diffracted_fraction: 1 - A_spec of HP17 Eq. 25 on a facet that the light meets along its normal, times the weight
      of the free split.
    - f0: HP17 Eq. 3 at theta_d = 0.

    Args:
        values: by name, as for :func:`merlfit.model.two_scale.two_scale`.
    """
    if not isinstance(material, TwoScale):
        return {}
    v = {name: jnp.asarray(x) for name, x in values.items()}
    n, k = (v["n"], v["k"]) if "n" in v else (v["eta"], jnp.zeros_like(v["eta"]))
    quantities_by_name = {
        LOBE.name: jnp.degrees(jnp.arctan(v["beta"] * np.log(2.0) ** (1 / (2 * v["p"])))),
        F0.name: fresnel(jnp.ones(()), n, k),
    }
    if material.diffraction != "off":
        wavelength = jnp.asarray(wavelengths_um)
        share = jnp.ones(())
        if material.renormalised:
            share = diffraction.renormalisation(jnp.zeros(()), v["b"] / wavelength, v["c"])
        phase = diffraction.phase_variance(share * v["sigma_s"] ** 2, jnp.ones(()), wavelength)
        weight = v["weight"] if material.split == "free" else 1.0
        quantities_by_name[DIFFRACTED.name] = -weight * jnp.expm1(-phase)
    return quantities_by_name
