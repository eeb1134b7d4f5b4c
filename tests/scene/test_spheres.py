"""Pictures of spheres against integrals that know nothing of bins, and their distance against known colours."""

import numpy as np
import pytest
from merlfit.merl_io.grid import merl_grid
from merlfit.scene import spheres
from merlfit.scene.colour import cielab
from merlfit.scene.lights import studio
from merlfit.scene.spheres import (
    LAMP,
    LAMP_RADIUS_RAD,
    PIXELS,
    compared,
    disc,
    distances,
    render,
    sphere,
)  # fmt: skip

from tests.support.compiled import from_vectors

WHITE = np.full((3, 90, 90, 90), 1 / np.pi)
EVERYWHERE = np.ones((90, 90, 90), bool)


def difference(one, other, used):
    """Over all pixels and both lights."""
    return distances(one, other, used)[0]


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def above(positions):
    """Normals of the sphere at these places of its picture."""
    return np.concatenate([positions, np.sqrt(1 - np.sum(positions**2, -1, keepdims=True))], -1)


def angles(i, o, normal):
    """theta_h, theta_d and phi_d folded onto [0, pi/2], by vectors."""
    h = unit(i + o)
    along = unit(h - np.sum(h * normal, -1, keepdims=True) * normal)  # azimuth of h about the normal
    across = np.cross(normal, along)
    # i in the frame that has h as its pole: turned by theta_h from the normal towards it
    theta_h = np.arctan2(np.linalg.norm(np.cross(normal, h), axis=-1), np.sum(normal * h, -1))
    ahead = np.cos(theta_h)[..., None] * along - np.sin(theta_h)[..., None] * normal
    theta_d = np.arctan2(np.linalg.norm(np.cross(i, h), axis=-1), np.sum(i * h, -1))
    phi_d = np.arctan2(np.abs(np.sum(i * across, -1)), np.abs(np.sum(i * ahead, -1)))
    return theta_h, theta_d, phi_d


def random_pairs(count, seed=1):
    """Light, viewer and normal, both above the surface."""
    rng = np.random.default_rng(seed)
    i, o, normal = unit(rng.normal(size=(3, count, 3)))
    i, o = (np.where(np.sum(x * normal, -1, keepdims=True) < 0, -x, x) for x in (i, o))
    return i, o, normal


def test_pairs_are_looked_up_as_merl_s_grid_has_them():
    i, o, normal = random_pairs(20_000)
    found = spheres._bins(i, o, normal)
    h, edges = angles(i, o, normal), merl_grid().edges
    places = [np.searchsorted(edge, x, side="right") - 1 for edge, x in zip(edges, h, strict=True)]
    expected = np.ravel_multi_index([np.clip(x, 0, 89) for x in places], (90, 90, 90))
    near = np.any([np.min(np.abs(x[:, None] - edge), 1) < 1e-9 for x, edge in zip(h, edges, strict=True)], 0)
    assert near.mean() < 1e-3
    np.testing.assert_array_equal(found[~near], expected[~near])
    assert len(np.unique(found)) > 10_000
    np.testing.assert_array_equal(spheres._bins(o, i, normal), found)  # reciprocal pairs share a folded bin


def test_the_angles_of_pairs_are_those_of_the_model():
    i, o, _ = random_pairs(200)
    up = np.broadcast_to([0.0, 0.0, 1.0], i.shape)
    i, o = (np.concatenate([x[:, :2], np.abs(x[:, 2:])], -1) for x in (i, o))
    g = from_vectors(i, o)
    theta_h, theta_d, phi_d = angles(i, o, up)
    np.testing.assert_allclose(theta_h, g.theta_h, atol=1e-9)
    np.testing.assert_allclose(theta_d, g.theta_d, atol=1e-9)
    apart = 2 * np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    np.testing.assert_allclose(apart, np.abs(o[:, 2] - i[:, 2]), atol=1e-9)


def test_directions_along_the_normal_and_at_the_horizon_have_bins():
    up, low = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    for i, o in ((up, up), (up, low), (low, low), (low, -low)):
        assert 0 <= spheres._bins(i, o, up) < 90**3
    assert spheres._bins(up, up, up) // 8100 == 0


def test_a_white_sphere_is_white_where_it_faces_the_lamp():
    facing = render(sphere("lamp", LAMP[None, :2]), WHITE)
    np.testing.assert_allclose(facing, 1, atol=LAMP_RADIUS_RAD**2 / 2)
    positions = disc(400)
    cosine = above(positions) @ LAMP
    found = render(sphere("lamp", positions), WHITE)
    assert found.shape == (400, 3)
    lit = cosine > 2 * LAMP_RADIUS_RAD
    np.testing.assert_allclose(found[lit], np.broadcast_to(cosine[lit, None], (lit.sum(), 3)), rtol=1e-3)
    dark = cosine < -2 * LAMP_RADIUS_RAD
    assert dark.sum() > 20
    assert np.all(found[dark] == 0)


def test_the_lamp_shows_a_lobe_as_it_is_measured():
    """A BRDF that differs from bin to bin, looked up by direction, averaged over the lamp's disc by random points."""
    rng = np.random.default_rng(3)
    grid = merl_grid()
    smooth = (
        1 / (0.05 + grid.theta_h[:, None, None]) + np.cos(grid.theta_d)[:, None] + np.cos(grid.phi_d[:90])
    ) * np.ones((3, 1, 1, 1))
    positions = disc(60)
    normal = above(positions)
    normal = normal[normal @ LAMP > 0.1]
    spread = np.tan(LAMP_RADIUS_RAD) * np.sqrt(rng.uniform(size=4000))
    turn = rng.uniform(0, 2 * np.pi, 4000)
    across = unit(np.cross(LAMP, [1.0, 0.0, 0.0]))
    light = unit(
        LAMP + spread[:, None] * (np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(LAMP, across))
    )
    camera = np.broadcast_to([0.0, 0.0, 1.0], light.shape)
    expected = []
    for n in normal:
        theta_h, theta_d, phi_d = angles(light, camera, np.broadcast_to(n, light.shape))
        brdf = 1 / (0.05 + theta_h) + np.cos(theta_d) + np.cos(phi_d)
        expected.append(np.pi * np.mean(brdf * np.maximum(light @ n, 0)))
    found = render(sphere("lamp", normal[:, :2]), smooth)[:, 0]
    np.testing.assert_allclose(found, expected, rtol=0.03)
    assert np.ptp(expected) > 5


def sphere_of_directions(count):
    """Directions spread evenly over the whole sphere: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, k * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], -1)


def received(normals, count=100_000):
    """Irradiance of the environment on surfaces, by directions that know nothing of half vectors."""
    i = sphere_of_directions(count)
    light = studio(i)
    return np.array([4 * np.pi * np.mean(light * np.maximum(i @ n, 0)) for n in normals])


@pytest.mark.parametrize(("azimuths", "worst", "typical"), [(96, 1e-3, 3e-4), (None, 0.015, 0.003)])
def test_the_environment_s_picture_of_a_white_sphere_is_its_irradiance(azimuths, worst, typical, monkeypatch):
    """To 1e-3 with azimuths enough; with the 24 that are taken, turned from row to row, to 0.015."""
    monkeypatch.setattr(spheres, "AZIMUTHS", azimuths or spheres.AZIMUTHS)
    positions = disc(60)
    normals = above(positions)
    expected = received(normals) / received(np.array([[0.0, 0.0, 1.0]]))
    found = render(sphere("environment", positions), WHITE)
    np.testing.assert_array_equal(found, found[:, :1] * np.ones(3))
    off = found[:, 0] / expected - 1
    assert np.max(np.abs(off)) < worst
    assert np.sqrt(np.mean(off**2)) < typical
    assert np.ptp(expected) > 0.3  # a picture, and no evenly grey disc


def test_the_environment_s_picture_of_a_lobe_is_the_integral_over_light():
    grid = merl_grid()
    width = 0.2
    lobe = np.exp(-((np.tan(grid.theta_h) / width) ** 2))[:, None, None] * np.ones((3, 90, 90, 90))
    positions = disc(40)
    i = sphere_of_directions(400_000)
    light, camera = studio(i), np.array([0.0, 0.0, 1.0])
    h = unit(i + camera)
    white = received(camera[None])[0] / np.pi
    expected = []
    for n in above(positions):
        cos_h = h @ n
        tangent = np.sqrt(np.maximum(1 - cos_h**2, 0)) / np.maximum(cos_h, 1e-6)
        sent = light * np.exp(-((tangent / width) ** 2)) * np.maximum(i @ n, 0)
        expected.append(4 * np.pi * np.mean(sent) / white)
    found = render(sphere("environment", positions), lobe)[:, 0]
    np.testing.assert_allclose(found, expected, rtol=0.1)
    assert abs(np.mean(found / expected) - 1) < 0.02


def test_the_disc_is_evenly_covered():
    points = disc(2000)
    radius = np.linalg.norm(points, axis=-1)
    assert radius.max() < 1
    for r in (0.3, 0.6, 0.9):
        assert np.mean(radius < r) == pytest.approx(r**2, abs=2e-3)
    np.testing.assert_allclose(points.mean(0), 0, atol=2e-3)


KNOWN = {  # linear sRGB, D65
    "white": ((1, 1, 1), (100, 0, 0)), "black": ((0, 0, 0), (0, 0, 0)),
    "mid grey": ((0.184186519,) * 3, (50, 0, 0)), "nearly black": ((0.001,) * 3, (0.9033, 0, 0)),
    "red": ((1, 0, 0), (53.24, 80.09, 67.20)), "green": ((0, 1, 0), (87.73, -86.18, 83.18)),
    "blue": ((0, 0, 1), (32.30, 79.19, -107.86)), "eight times white": ((8, 8, 8), (216, 0, 0)),
}  # fmt: skip


@pytest.mark.parametrize("name", KNOWN)
def test_colours_are_those_of_the_tables(name):
    linear, lab = KNOWN[name]
    np.testing.assert_allclose(cielab(np.array(linear, float)), lab, atol=0.02)


def test_light_below_nothing_is_black():
    np.testing.assert_allclose(cielab(np.full((2, 3), -1.0)), 0, atol=1e-12)


def glossy(peak):
    lobe = np.exp(-((np.tan(merl_grid().theta_h) / 0.05) ** 2))
    return 0.05 + peak * lobe[:, None, None] * np.ones((3, 90, 90, 90))


def test_equal_spheres_do_not_differ_and_others_do_both_ways_alike():
    one, other = glossy(20.0), glossy(10.0)
    assert difference(one, one, EVERYWHERE) == 0
    assert difference(one, other, EVERYWHERE) == difference(other, one, EVERYWHERE) > 0.3


def test_the_difference_grows_with_the_highlight_that_is_lost():
    found = [difference(glossy(20.0), glossy(peak), EVERYWHERE) for peak in (19.0, 15.0, 5.0, 0.0)]
    assert np.all(np.diff(found) > 0)
    assert found[-1] > 4 * found[0]


def test_the_difference_is_the_mean_distance_over_both_lights():
    one, other = glossy(20.0), 0.7 * glossy(15.0)
    apart = []
    for lighting in ("lamp", "environment"):
        labs = [cielab(render(compared(lighting), x)) for x in (one, other)]
        assert labs[0].shape == (PIXELS[lighting], 3)
        apart.append(np.mean([np.sqrt(np.sum((a - b) ** 2)) for a, b in zip(*labs, strict=True)]))
    assert difference(one, other, EVERYWHERE) == pytest.approx(np.mean(apart), rel=1e-12)
    assert apart[0] != pytest.approx(apart[1], rel=0.05)


def test_lit_pixels_alone_count_by_lighting_and_highlights_are_not_clipped():
    """A mirror's lamp picture is black but for its highlight: of all pixels the mean says nothing of it."""
    lobe = np.exp(-((np.tan(merl_grid().theta_h) / 0.02) ** 2))[:, None, None] * np.ones((3, 90, 90, 90))
    one, other = 400 * lobe, 200 * lobe  # both brighter than white
    both, lamp, environment = distances(one, other, EVERYWHERE)
    apart = {}
    for lighting in ("lamp", "environment"):
        labs = [cielab(render(compared(lighting), x)) for x in (one, other)]
        each = [np.sqrt(np.sum((a - b) ** 2)) for a, b in zip(*labs, strict=True) if max(a[0], b[0]) > 1]
        apart[lighting] = len(each), np.mean(each)
    assert apart["lamp"][0] < 0.2 * PIXELS["lamp"]
    assert lamp == pytest.approx(apart["lamp"][1], rel=1e-9)
    assert environment == pytest.approx(apart["environment"][1], rel=1e-9)
    assert lamp > 5 > 1 > difference(0 * one, 0 * one, EVERYWHERE)
    assert both == difference(one, other, EVERYWHERE)


def test_a_neutral_metal_that_is_fitted_brown_is_seen_in_the_environment():
    grey = glossy(20.0)
    brown = grey * np.array([1.2, 1.0, 0.7])[:, None, None, None]
    assert distances(grey, brown, EVERYWHERE)[2] > 5


def test_what_is_black_in_both_spheres_is_not_different():
    assert distances(0 * glossy(1.0), 0 * glossy(1.0), EVERYWHERE) == (0, 0, 0)


def test_bins_that_are_not_used_do_not_show():
    used = merl_grid().above[..., :90] & (merl_grid().theta_h < 1.0)[:, None, None]
    one, other = glossy(20.0), glossy(10.0)
    expected = difference(one, other, used)
    assert difference(np.where(used, one, np.nan), np.where(used, other, 1e3), used) == expected
    assert expected != difference(one, other, EVERYWHERE)
