"""Files of RGL's kind of a known material: synthetic data, as their instrument would have measured them.

The parameterization is that of a GGX surface, whatever the material: only where the nodes lie depends on it. Values are
computed at the directions that the nodes have by the oracle, which knows nothing of the reader.
"""

import numpy as np
from merlfit.merl_io.tensor import packed

from ..oracles import rgl


def write(path, fields):
    """A file of these fields."""
    path.write_bytes(packed(fields))
    return path


def parameterization(alpha=0.3, theta_i=(0, 10, 20, 30, 45, 60, 70, 80), resolution=64, nodes=32):
    """Fields that say where the nodes lie."""
    theta_i = np.radians(theta_i)
    u = np.linspace(0, 1, 2 * resolution)
    ndf, sigma = ggx(u**2 * np.pi / 2, alpha), projected(u**2 * np.pi / 2, alpha)
    u, v = np.linspace(0, 1, resolution), np.linspace(0, 1, resolution)[:, None]
    theta, phi = u**2 * np.pi / 2, (2 * v - 1) * np.pi
    shape = 2 * np.pi**2 * u * np.sin(theta) * ggx(theta, alpha)
    cosine = [np.cos(t) * np.cos(theta) + np.sin(t) * np.sin(theta) * np.cos(phi) for t in theta_i]
    vndf = [shape * np.maximum(c, 0) / projected(np.array([t]), alpha)[0] for c, t in zip(cosine, theta_i, strict=True)]
    return {
        "description": np.frombuffer(b"synthetic", np.uint8), "jacobian": np.array([1], np.uint8),
        "theta_i": np.float32(theta_i), "phi_i": np.zeros(1, np.float32),
        "ndf": np.float32(np.stack([ndf, ndf])), "sigma": np.float32(np.stack([sigma, sigma])),
        "vndf": np.float32(np.stack(vndf))[None], "luminance": np.ones((1, len(theta_i), nodes, nodes), np.float32),
    }  # fmt: skip


def ggx(theta, alpha):
    """Density of normals, 1/sr."""
    return alpha**2 / (np.pi * ((alpha**2 - 1) * np.cos(theta) ** 2 + 1) ** 2)


def projected(theta, alpha, count=400):
    """Area of the facets that are seen at angles theta to the normal, by quadrature."""
    t = (np.arange(count) + 0.5) / count * np.pi / 2
    phi = (np.arange(count) + 0.5) / count * np.pi
    weight = ggx(t, alpha) * np.sin(t) * (np.pi / 2 / count) * (np.pi / count) * 2
    return np.array([
        np.sum(weight[:, None] * np.maximum(
            np.cos(x) * np.cos(t)[:, None] + np.sin(x) * np.sin(t)[:, None] * np.cos(phi), 0)) for x in theta
    ])  # fmt: skip


def directions(fields):
    """theta_i, theta_o, phi (rad) of all nodes and how much S is of f, (P, T, n, n); NaN below the horizon."""
    nodes = fields["luminance"].shape[-1]
    steps = np.linspace(0, 1, nodes)
    found = np.full((4, *fields["luminance"].shape), np.nan)
    for p, t in np.ndindex(fields["vndf"].shape[:2]):
        theta_i = float(fields["theta_i"][t])
        if theta_i >= np.pi / 2:
            continue
        i = np.array([np.sin(theta_i), 0, np.cos(theta_i)])
        sigma = rgl.bilinear(fields["sigma"], *rgl.to_square(theta_i, float(fields["phi_i"][p])))
        for row, column, u, v in nodes_of(fields["vndf"][p, t].astype(float), steps):
            theta_m, phi_m = u**2 * np.pi / 2, (2 * v - 1) * np.pi
            m = np.array([np.sin(theta_m) * np.cos(phi_m), np.sin(theta_m) * np.sin(phi_m), np.cos(theta_m)])
            o = 2 * (i @ m) * m - i
            if i @ m > 0 and o[2] > 0:
                d = rgl.bilinear(fields["ndf"], u, v)
                s = 4 * sigma * o[2] / d if fields["jacobian"][0] else o[2]
                found[:, p, t, row, column] = theta_i, *rgl.angles(o), s
    return found


def nodes_of(density, steps):
    """Row, column, u and v of all."""
    for row, t in enumerate(steps):
        for column, s in enumerate(steps):
            yield row, column, *rgl.forth(density, s, t)


def made(fields, brdf, nm=None):
    """The fields of a whole file of ``brdf(theta_i, theta_o, phi) -> (C, N)``, at wavelengths (nm) or of RGB."""
    theta_i, theta_o, phi, factor = directions(fields)
    above = np.isfinite(factor)
    values = brdf(theta_i[above], theta_o[above], phi[above]) * factor[above]
    spectra = np.zeros((len(values), *above.shape), np.float32)
    spectra[:, above] = values
    whole = {"spectra" if nm is not None else "rgb": np.moveaxis(spectra, 0, 2)}
    if nm is not None:
        whole["wavelengths"] = np.float32(nm)
    return {**fields, "luminance": np.float32(above), **whole}
