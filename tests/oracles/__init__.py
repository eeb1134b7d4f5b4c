"""Slow, honest oracles of the two-scale model, written from the papers with numpy, scipy and mpmath alone.

They import nothing of the package they judge, and take other routes than the obvious fast ones.
HP17 is Holzschuch & Pacanowski 2017 (doi:10.1145/3072959.3073621), IL is Meneveaux et al., *Rendering rough opaque
materials with interfaced Lambertian microfacets*. Angles are in radians, lengths in micrometres.
"""
