"""PHYSICS: reflectance models as pure, differentiable JAX functions; knows no file and no fit.

float64 is switched on here, in this one place: every module that computes with JAX is reached through this package.
Not all of them compute: settings are read from what is declared here, and do not wait for JAX.
"""

import os
import sys

if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)
else:
    os.environ["JAX_ENABLE_X64"] = "1"  # which JAX asks for when it is imported
