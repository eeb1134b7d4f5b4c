"""What glTF and OpenPBR draw: numbers computed by hand from the specifications' formulas, and what is nearest."""

import numpy as np
import pytest
from merlfit.fitting.commands.nearest_ggx import Angles, fresnel_dielectric, gloss_albedo, gltf, nearest, openpbr
from merlfit.fitting.pipeline.synthesis import tabulate
from merlfit.merl_io.grid import merl_grid
from merlfit.model.reflectance import evaluate
from merlfit.model.registry import models
from merlfit.scene.spheres import distances

NORMAL = Angles(*np.ones((4, 1)))
# light and viewer at 60 degrees, mirrored: cos_d = 1/2, h is the normal
MIRROR = Angles(*np.array([[0.5], [0.5], [1.0], [0.5]]))
BY_HAND = {
    # glTF, Appendix B.3, roughness sqrt(1/2): alpha^2 = 1/4, D = 1/(pi alpha^2) = 4/pi.
    # Along the normal V = 1/4, F = f0 = 0.04 for ior 1.5.
    "gltf, along the normal": (gltf, NORMAL, 1.5, 0.96 / np.pi, 0.04 / np.pi),
    # At 60 degrees: |NL| + sqrt(1/4 + 3/4 * 1/4) = 1/2 + sqrt(7)/4 twice; F = 0.04 + 0.96/32 = 0.07
    "gltf, mirrored at 60": (gltf, MIRROR, 1.5, 0.93 / np.pi, 0.07 * 4 / np.pi / (0.5 + np.sqrt(7) / 4) ** 2),
    # ior 1: F = (1 - cos_d)^5, what case 01 needs
    "gltf, ior 1": (gltf, MIRROR, 1.0, (31 / 32) / np.pi, (1 / 32) * 4 / np.pi / (0.5 + np.sqrt(7) / 4) ** 2),
    "gltf, metal": (
        gltf, MIRROR, None,
        (31 / 32) * 4 / np.pi / (0.5 + np.sqrt(7) / 4) ** 2, (1 / 32) * 4 / np.pi / (0.5 + np.sqrt(7) / 4) ** 2,
    ),
    # OpenPBR: masking of both together, 1 / (2 (NL sqrt(7)/4 + NV sqrt(7)/4)) = 2/sqrt(7); Fresnel's own factor at 60
    # degrees: inside cosine sqrt(2.25 - 0.75)/1.5, r_s = (0.5 - sqrt(1.5))/(0.5 + sqrt(1.5)),
    # r_p = (1.125 - sqrt(1.5))/(1.125 + sqrt(1.5)): F = (0.176719 + 0.001797)/2 = 0.0892
    "openpbr, mirrored at 60": (openpbr, MIRROR, 1.5, None, 0.0892 * 4 / np.pi * 2 / np.sqrt(7)),
    "openpbr, metal": (openpbr, MIRROR, None, (31 / 32) * 8 / np.pi / np.sqrt(7), (1 / 32) * 8 / np.pi / np.sqrt(7)),
}  # fmt: skip


@pytest.mark.parametrize("name", BY_HAND)
def test_formats_draw_what_their_specifications_say(name):
    draw, angles, ior, slope, rest = BY_HAND[name]
    found = draw(angles, np.sqrt(0.5), ior)
    np.testing.assert_allclose(found[1], rest, rtol=2e-4)
    if slope is not None:
        np.testing.assert_allclose(found[0], slope, rtol=1e-12)


ROUGHEST = 1.0
BODIES = {
    # OpenPBR's body along the normal, (1 - E)/pi, under facets of roughness 1: D = 1/pi, masking 1/(2 (1 + NL)), and so
    # E = int_0^1 F NL/(1 + NL) dNL. Of an index without end F = 1: E = 1 - ln 2.
    1e6: (np.log(2) / np.pi, 1 / (4 * np.pi)),
    # Of 1.5, F = 0.05024, 0.04436, 0.04152, 0.04031, 0.04 where NL = 0, 1/4 .. 1, the half vector half as far from the
    # normal: by Simpson's rule E = (0 + 4 * 0.00887 + 2 * 0.01384 + 4 * 0.01727 + 0.02)/12 = 0.01269
    1.5: ((1 - 0.01269) / np.pi, 0.04 / (4 * np.pi)),
}


@pytest.mark.parametrize("ior", BODIES)
def test_the_body_of_openpbr_is_weighed_by_what_the_gloss_leaves(ior):
    """To 2e-3 of the light, as `gloss_albedo` says; the square of ln 2, of light weighed on both ways, is 0.2 off."""
    slope, rest = BODIES[ior]
    found = openpbr(NORMAL, ROUGHEST, ior)
    np.testing.assert_allclose(np.pi * found[0], np.pi * slope, atol=2.1e-3)
    np.testing.assert_allclose(found[1], rest, rtol=1e-5)


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
def test_the_albedo_of_a_gloss_is_the_integral_of_its_facets(roughness):
    """Against a sum over directions of light that knows nothing of facets (2e-3); a mirror's is Fresnel's factor."""
    cosines, found = gloss_albedo(roughness, 1.5)
    assert np.all((found > 0) & (found < 1))
    for k in (12, 30, 47):
        o = np.array([np.sqrt(1 - cosines[k] ** 2), 0.0, cosines[k]])
        mirrored = gloss_mean(o, roughness) if roughness > 0.3 else fresnel_dielectric(cosines[k : k + 1], 1.5)[0]
        assert found[k] == pytest.approx(mirrored, abs=2e-3)


def gloss_mean(o, roughness, count=400_000):
    k = np.arange(count) + 0.5  # light over the hemisphere, by its cosine
    cos, turn = np.sqrt(k / count), k * np.pi * (3 - np.sqrt(5))
    i = np.stack([np.sqrt(1 - cos**2) * np.cos(turn), np.sqrt(1 - cos**2) * np.sin(turn), cos], -1)
    h = i + o
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    brdf = openpbr(Angles(i[:, 2], np.full(count, o[2]), h[:, 2], h @ o), roughness, 1.5)[1]
    return np.pi * brdf.mean()


TILE = {"alpha": 0.73352, "F0": np.array([0.74543, 0.78636, 0.86795]), "albedo": np.array([0.70258, 0.67574, 0.62117])}
"""The GGX fit of a white tile: as a dielectric its F0 makes an index of 17.9."""


def test_the_nearest_material_is_chosen_and_its_error_stated_by_what_the_format_draws():
    """Facets of index 17.9 over a white body, drawn as glTF layers them, are 20 off, not 2.24."""
    values = tabulate(lambda g: evaluate(models()["ggx"](), TILE, g))
    found = nearest(values, "gltf")
    ours = (values[..., :90] + values[..., :89:-1]) / 2
    above = merl_grid().above[..., :90]
    h, d = np.cos(merl_grid().theta_h)[:, None, None], np.cos(merl_grid().theta_d)[:, None]
    angles = Angles(*(np.clip(x[..., :90], 0, 1) for x in (merl_grid().cos_i, merl_grid().cos_o)), h, d)

    def off(base, roughness, ior):
        slope, rest = gltf(angles, roughness, ior)
        return distances(ours, np.reshape(base, (3, 1, 1, 1)) * slope + rest, above)[0]

    assert off(TILE["albedo"], TILE["alpha"] ** 0.5, 17.9) > 18
    assert off(np.ones(3), 0.857, 1.0) == pytest.approx(2.24, abs=0.005)
    assert found["error"]["cielab"] == pytest.approx(off(found["base_color"], found["roughness"], found["ior"]))
    assert found["error"]["cielab"] < 2.24
    assert (found["metallic"], found["ior"]) == (0, pytest.approx(1, abs=0.02))
