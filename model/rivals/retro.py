"""Light that goes back to where it came from: facets of the mirrored direction over a Lambert body."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..acquisition import RINGS_RAD
from ..body import lambert
from ..ndf import ggx
from ..parameters import Parameter
from ..priors import LogNormal
from ..reflectance import OneFormula, Profile, Setting, Values
from .common import DIFFUSE


@dataclass(frozen=True)
class Retro(OneFormula):
    """k_r (cos_i cos_o)^m D(theta_h') G1(i) G1(o) / (4 cos_i cos_o) + rho_d/pi, theta_h' with the viewer mirrored.

    The back-vector model (Belcour et al. 2014; Portsmouth et al. 2026) with a GGX distribution, and a weight per
    channel in place of the Fresnel factor, of which beads and prisms have none. m is no part of it: prisms send back
    the less the more light slants, where the lobe of facets grows as 1/cos^2 (docs/rivals.md); 0 is the published
    model. Reciprocal, and of no larger albedo than the same facets have as mirrors.

    Accuracy: 1e-10 against an independent oracle (``tests/rivals/test_peers.py``).
    """

    name: ClassVar[str] = "retro"
    citation: ClassVar[str] = (
        "Portsmouth, Raab, Belcour & Liu 2026, The minimal retroreflective microfacet model, JCGT 15(1), "
        "doi:10.48550/arXiv.2606.08739; Belcour, Pacanowski, Delahaie et al. 2014, Performance comparison of "
        "bidirectional reflectance distribution functions with retroreflection, doi:10.1364/JOSAA.31.002561"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return (
            Parameter("alpha", r"\alpha", "width of the distribution of back vectors", "1", 0.2, 1e-3, 1.0,
                      source="Portsmouth et al. 2026", prior=LogNormal(0.15, 4.0)),
            Parameter("falloff", "m", "exponent of the cosines, by which slanting light goes back less", "1", 0.5, 0.0,
                      12.0, "linear", source="merlfit"),
            Parameter("k_r", "k_r", "weight of the light that goes back", "1", 0.1, 0.0, 1.0, "linear",
                      per_channel=True, source="Portsmouth et al. 2026", quantity="odds"),
            DIFFUSE,
        )  # fmt: skip

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102
        return {"specular": lambda v, middle_um: ggx.D(jnp.asarray(RINGS_RAD), v["alpha"])}

    def sharp(self, v: Values, s: Setting) -> Array:  # noqa: D102
        g, alpha = s.geometry.mirrored, v["alpha"]
        G = ggx.G1(g.cos_i, alpha) * ggx.G1(g.cos_o, alpha)
        cosines = g.cos_i * g.cos_o
        return v["k_r"] * ggx.D(g.theta_h, alpha) * G * jnp.exp((v["falloff"] - 1) * jnp.log(cosines)) / 4

    def body(self, v: Values, s: Setting) -> Array:  # noqa: D102
        return lambert(v["diffuse_albedo"])
