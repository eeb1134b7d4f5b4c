"""What several rival models share: parameters, citations, and how layered ones name and mix their layers."""

from jax import Array

from ..parameters import Parameter, exponent_of
from ..priors import LogNormal

LOEW_PAPER = (
    "Loew, Kronander, Ynnerman & Unger 2012, BRDF models for accurate and efficient rendering of glossy surfaces, "
    "doi:10.1145/2077341.2077350"
)
DIFFUSE = Parameter("diffuse_albedo", r"\rho_d", "albedo of the diffuse term", "1", 0.1, 0.0, 1.0, "linear",
                    per_channel=True, source="Cook & Torrance 1982", quantity="odds")  # fmt: skip
LOEW_ETA = Parameter("eta", r"\eta", "index of refraction", "1", 1.5, 1.001, 200.0, offset=1.0,
                     source="Loew et al. 2012", prior=LogNormal(0.8, 3.0))  # fmt: skip
COAT_LOBE = "specular_coat"  # of a layered model, beside the lobe of its facets
LOST_OF_COAT = frozenset({exponent_of(COAT_LOBE).name, f"{COAT_LOBE}_exponent"})
"""Names of the apparatus's values of that lobe."""


def mix(one: Array | float, other: Array | float, share: Array) -> Array:
    """The first with a share of the other in its place."""
    return one + share * (other - one)
