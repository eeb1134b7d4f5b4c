"""PHYSICS: reflectance models as pure, differentiable JAX functions; knows no file and no fit.

float64 is switched on here, in this one place: every module that computes with JAX is reached through this package.
"""

import jax

jax.config.update("jax_enable_x64", True)
