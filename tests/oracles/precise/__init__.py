"""The formulas of the two-scale model at 30 digits, for single points and any extreme: mpmath throughout.

Arguments are those of the functions of the same name in ``model/``, as floats or mpf, taken for exact. Arithmetic has
30 digits (40 where digits cancel). Integrals run over fixed rules whose nodes move smoothly with the arguments, so that
differences of their values are derivatives as good as the values: 1e-20 for one-dimensional integrals, 1e-8 for the
convolution. The routes are other ones than the fast code's: complex arithmetic for the colours, periodic and doubly
exponential trapezoid rules for Lambda, the boundary of the disc for the renormalisation, the closed form for diffuse
Fresnel reflectances, plain panels of the spherical integral for the convolution.
"""

from .acquisition import grazing
from .arithmetic import slope
from .body import lambert, plastic, subsurface
from .colour import diffraction_colour, fresnel, schlick
from .convolution import convolve
from .diffraction import lobe, renormalisation, specular_share
from .exact import exact_lobe
from .facets import lobe_albedo
from .surface import epd, masking, smith_lambda
from .two_scale import two_scale

__all__ = [
    "convolve", "diffraction_colour", "epd", "exact_lobe", "fresnel", "grazing", "lambert", "lobe",
    "lobe_albedo", "masking", "plastic", "renormalisation", "schlick", "slope", "smith_lambda", "specular_share",
    "subsurface", "two_scale",
]  # fmt: skip
