"""Pictures against integrals and geometry that know nothing of the renderer."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model.registry import models
from merlfit.model.sampling.visible import Visible
from merlfit.model.two_scale import TwoScale
from merlfit.scene import lights
from merlfit.scene.colour import cielab, displayed
from merlfit.scene.colour import difference as distance
from merlfit.scene.description import Scene
from merlfit.scene.render import Film, lit, pictures, radiance, stage
from merlfit.scene.surface import PRECISION, drawn, measurement, surface

from tests.support.compiled import evaluate, from_half_difference, from_vectors

PLASTIC = {
    "beta": 0.15, "p": 0.8, "b": 1.0, "c": 2.0, "sigma_s": 0.03, "eta": np.full(3, 1.5),
    "albedo": np.array([0.5, 0.2, 0.1]),
}  # fmt: skip
GGX = {"alpha": 0.3, "F0": np.array([0.9, 0.6, 0.3]), "albedo": np.array([0.1, 0.2, 0.3])}
WHITE = {"alpha": 0.3, "F0": np.full(3, 1e-9), "albedo": np.ones(3)}


def scene(**changes):
    base = {
        "camera": {"position": (0, 0, 6), "field_of_view_deg": 22, "width": 16, "height": 16},
        "sphere": [{"material": "a"}], "materials": {"a": {"model": "ggx"}}, "samples": 64,
    }  # fmt: skip
    return Scene.model_validate({**base, **changes})


def rendered(made, *materials, radiance=None):
    film = Film(made, stage(made, radiance))
    (found,) = pictures(film, [drawn(m) for m in materials])
    return found


def ggx(values=GGX):
    return surface(models()["ggx"](), values)


def normals(made):
    """Of the sphere at the centre of each pixel, NaN where there is none: the ray's meeting point, by hand."""
    half = np.tan(np.radians(made.camera.field_of_view_deg) / 2)
    steps = (np.arange(16) + 0.5) / 16 * 2 - 1
    x, y = np.meshgrid(steps * half, -steps * half)
    ray = np.stack([x, y, -np.ones_like(x)], -1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    eye = np.array([0, 0, 6.0])
    along = -ray @ eye
    square = 1 - (36 - along**2)
    distance = along - np.sqrt(np.where(square > 0, square, np.nan))
    return eye + distance[..., None] * ray, ray


def test_a_white_sphere_in_a_white_room_is_white():
    found = rendered(scene(environment={"kind": "constant"}), ggx(WHITE))
    np.testing.assert_allclose(found[5:11, 5:11], 1.0, rtol=5e-3)
    assert np.all(found[0, 0] == 0)


def test_a_lamp_lights_by_the_cosine():
    made = scene(lamp=[{"towards": (0, 0.6, 0.8), "irradiance": np.pi, "radius_deg": 0}], samples=256)
    normal, _ = normals(made)
    expected = np.maximum(normal @ [0, 0.6, 0.8], 0)
    found = rendered(made, ggx(WHITE))[..., 0]
    inner = np.hypot(normal[..., 0], normal[..., 1]) < 0.8
    np.testing.assert_allclose(found[inner], expected[inner], atol=0.03)  # a pixel covers 0.03 of the slope


def test_a_wide_lamp_gives_its_irradiance():
    made = scene(
        lamp=[{"towards": (0, 0, 1), "irradiance": np.pi, "radius_deg": 40}], samples=1024,
        sphere=[], rectangle=[{"material": "a", "corner": (-9, -9, 0), "across": (18, 0, 0), "up": (0, 18, 0)}],
    )  # fmt: skip
    np.testing.assert_allclose(rendered(made, ggx(WHITE)), 1.0, rtol=5e-3)


@pytest.mark.parametrize("kind", ["ggx", "two-scale"])
def test_a_pixel_under_the_studio_is_the_integral(kind):
    """Over all directions by a fine grid of them, without samplers."""
    made = scene(environment={"kind": "studio"}, samples=4096)
    model, values = (models()["ggx"](), GGX) if kind == "ggx" else (TwoScale("plastic", order=8), PLASTIC)
    found = rendered(made, surface(model, values))
    normal, ray = normals(made)
    to = lights.directions(300, 600).reshape(-1, 3)
    solid_angle = np.repeat(np.diff(-np.cos(np.linspace(0, np.pi, 301))), 600) * 2 * np.pi / 600
    light = np.asarray(lights.studio(to))
    for row, column in ((5, 6), (8, 8), (10, 4)):
        n, o = normal[row, column], -ray[row, column]
        across = np.cross(n, [0, 1.0, 0]) / np.linalg.norm(np.cross(n, [0, 1.0, 0]))
        frame = np.stack([across, np.cross(n, across), n])
        above = np.argsort(-to @ n)[: len(to) // 2]  # at most half of them are; as many for each pixel
        i, viewer = to[above] @ frame.T, np.broadcast_to(frame @ o, (len(above), 3))
        brdf = np.asarray(evaluate(model, values, from_vectors(i, viewer)))
        brdf = np.where(i[:, 2] > 1e-3, brdf, 0.0)
        expected = (brdf * i[:, 2] * light[above] * solid_angle[above]).sum(1)
        # the centre of a pixel for its mean: windows are smooth over it
        np.testing.assert_allclose(found[row, column], expected, rtol=0.06)


def test_shapes_cast_shadows_and_hide_each_other():
    made = scene(
        lamp=[{"towards": (0, 1, 0), "irradiance": np.pi, "radius_deg": 0}],
        camera={"position": (0, 3, 8), "field_of_view_deg": 40, "width": 32, "height": 32},
        sphere=[{"material": "a", "centre": (0, 1.2, 0), "radius": 1}],
        rectangle=[{"material": "b", "corner": (-4, 0, 4), "across": (8, 0, 0), "up": (0, 0, -8)}],
        materials={"a": {"model": "ggx"}, "b": {"model": "ggx"}},
    )
    found = rendered(made, ggx(WHITE), ggx(WHITE))[..., 0]
    floor = found[17:28]  # lit, and dark under the sphere
    assert floor.max() == pytest.approx(1.0, abs=1e-3)
    assert floor[:, 12:20].min() < 0.05
    assert found[21:28, :4].min() > 0.99


def test_the_same_seed_gives_the_same_picture_and_another_the_same_mean():
    made = scene(environment={"kind": "studio"})
    one, same = (rendered(made, ggx()) for _ in range(2))
    other = rendered(made.model_copy(update={"seed": 7}), ggx())
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    np.testing.assert_allclose(one.mean((0, 1)), other.mean((0, 1)), rtol=0.03)  # of one seed, 0.8 %


def test_a_map_that_is_the_studio_gives_its_picture():
    made = scene(environment={"kind": "studio"})
    radiance = np.repeat(np.asarray(lights.studio(lights.directions(256, 512)))[..., None], 3, -1)
    as_map = made.model_copy(
        update={"environment": made.environment.model_copy(update={"kind": "map", "file": "x.exr"})}
    )
    np.testing.assert_allclose(rendered(as_map, ggx(), radiance=radiance), rendered(made, ggx()), rtol=1e-5)


def test_directions_of_an_environment_follow_its_density():
    rng = np.random.default_rng(3)
    around = lights.environment(rng.random((8, 16, 3)) ** 4)
    drawn_ = np.asarray(eqx.filter_jit(around.draw)(rng.random((200_000, 2), np.float32)))
    density = np.asarray(eqx.filter_jit(around.density)(drawn_))
    np.testing.assert_allclose(np.linalg.norm(drawn_, axis=1), 1, atol=1e-6)
    # E[f / density] is the integral of f: of 1, and of two functions of the direction
    assert np.mean(1 / density) == pytest.approx(4 * np.pi, rel=0.01)
    assert np.mean(drawn_[:, 1] ** 2 / density) == pytest.approx(4 * np.pi / 3, rel=0.02)
    assert np.mean(np.maximum(drawn_[:, 0], 0) / density) == pytest.approx(np.pi, rel=0.02)


def test_a_sun_of_one_pixel_is_drawn_as_often_as_it_is_bright():
    radiance = np.ones((1000, 2001, 3))
    radiance[300, 700] = 1e6
    around = lights.environment(radiance)
    sun = np.sin(300.5 / 1000 * np.pi) * (np.pi / 1000) * (2 * np.pi / 2001) * 1e6
    rng = np.random.default_rng(0)
    drawn_ = np.asarray(eqx.filter_jit(around.draw)(rng.random((20_000, 2), np.float32)))
    near = drawn_ @ lights.directions(1000, 2001)[300, 700] > np.cos(np.radians(0.6))
    assert near.mean() == pytest.approx(sun / (sun + 4 * np.pi), abs=0.02)


def test_light_beside_a_sun_is_no_firefly():
    """Radiance is linear between cells: nearly half of a sun of one pixel is seen in the cells beside it."""
    radiance = np.full((128, 256, 3), 0.3)
    radiance[40, 100] = 3e4
    around = lights.environment(radiance)
    beside = lights.directions(4 * 128, 4 * 256)[4 * 39 : 4 * 42, 4 * 99 : 4 * 102].astype(np.float32)
    weighed = np.asarray(around.look(beside)[..., 0] / around.density(beside))
    assert weighed.max() < 400  # twenty times the mean of all draws, the light from all around; without the mend 6e5


def test_a_measured_material_looks_like_the_model_it_was_made_from():
    from merlfit.merl_io.grid import merl_grid

    grid = merl_grid()
    g = from_half_difference(grid.theta_h[:, None, None], grid.theta_d[None, :, None], grid.phi_d[None, None, :90])
    model = models()["ggx"]()
    table = measurement(np.asarray(evaluate(model, GGX, g)), grid.above[..., :90])
    made = scene(environment={"kind": "studio"}, samples=256)
    one, other = rendered(made, table), rendered(made, surface(model, GGX))
    assert np.quantile(distance(one, other)[4:12, 4:12], 0.9) < 0.7


def test_colours():
    np.testing.assert_allclose(cielab(np.ones(3)), [100, 0, 0], atol=0.02)
    brighter = distance(np.full(3, 2.0), np.full(3, 9.0))  # though both are white on a screen
    np.testing.assert_allclose(brighter, 116 * (np.cbrt(9) - np.cbrt(2)))
    np.testing.assert_array_equal(displayed(np.array([0.0, 0.2158605, 1.0, 7.0])), [0, 128, 255, 255])


def test_all_of_a_picture_is_in_single_precision():
    """Drawn by visible facets, under an environment and a lamp, of a model and of a measurement."""
    made = scene(environment={"kind": "studio"}, lamp=[{"towards": (0, 1, 1), "irradiance": 1, "radius_deg": 1}])
    film, pixel = Film(made, stage(made), 2), np.array([120], np.int32)
    material, sampler = drawn(ggx({**GGX, "alpha": 0.05}))
    assert isinstance(sampler, Visible)
    of = lambda pixel: lit(film.stage, sampler, jnp.asarray(0), pixel, film.numbers.of(pixel))  # noqa: E731
    rays = jax.eval_shape(of, pixel)
    assert {x.dtype for x in rays} == {jnp.dtype(PRECISION)}
    assert jax.eval_shape(sampler.density, rays.o, rays.i).dtype == PRECISION
    table = measurement(np.ones((3, 90, 90, 90)), np.ones((90, 90, 90), bool))
    for each in (material, table):
        assert jax.eval_shape(lambda rays, each=each: radiance(each, rays), rays).dtype == PRECISION
