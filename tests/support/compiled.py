"""The model's functions as one program each: called as they are, every operation in them is a program of its own."""

import jax
from merlfit.model import reflectance
from merlfit.model import two_scale as of_two_scale

evaluate = jax.jit(reflectance.evaluate, static_argnames=("model", "wavelengths_um"), inline=True)
two_scale = jax.jit(of_two_scale.two_scale, static_argnames=("model", "wavelengths_um"), inline=True)
