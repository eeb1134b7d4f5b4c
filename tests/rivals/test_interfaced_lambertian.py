"""Interfaced Lambertian facets: the sum against the integral, its limits, anisotropy and paths through cavities."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError
from merlfit.model.body import plastic
from merlfit.model.fresnel import fresnel_of_dielectric
from merlfit.model.rivals.interfaced_lambertian import InterfacedLambertian, through
from scipy.integrate import quad

from tests.oracles import microfacets
from tests.oracles import rivals as oracle
from tests.oracles.facets import direction
from tests.reference import sampled_facets
from tests.reference.cavities import Cavities, ManyFacets
from tests.support.compiled import evaluate, from_vectors

ETA, ALBEDO = np.array([1.5, 1.2, 2.0]), np.array([0.9, 0.5, 0.1])
KINDS = [
    ("beckmann", "smith"),
    ("beckmann", "v-groove"),
    ("ggx", "smith"),
    ("ggx", "v-groove"),
    ("gaussian", "v-groove"),
]
DRAWN = jax.jit(sampled_facets.body, static_argnames=("roughness", "normals", "count"))
PATHS = jax.jit(sampled_facets.paths, static_argnames=("roughness", "index", "albedo", "count", "normals", "most"))
ON_SENSOR = jax.jit(sampled_facets.on_sensor, static_argnames=("half_angle", "bounces"))
every = pytest.mark.parametrize(("normals", "masking"), KINDS)


def pairs(count, seed=3, most=75.0):
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(np.cos(np.radians(most)), 1, (count, 2)))
    return np.swapaxes([[direction(t, rng.uniform(0, 2 * np.pi)) for t in each] for each in theta], 0, 1)


LIGHT, VIEWER = pairs(150)  # of most tests, so that one program of a model serves them


def values(model, width, **changes):
    return {model.parameters[0].name: width, "eta": ETA, "albedo": ALBEDO, **changes}


def body(model, width, i, o, **changes):
    """What the substrate adds."""
    g, given = from_vectors(i, o), values(model, width, **changes)
    return np.asarray(evaluate(model, given, g)) - np.asarray(evaluate(model, {**given, "albedo": np.zeros(3)}, g))


@every
@pytest.mark.parametrize("width", [0.15, 0.5])
def test_the_reference_is_the_integral(normals, masking, width):
    model = ManyFacets(normals, masking)
    few = list(zip(LIGHT[:4], VIEWER[:4], strict=True))
    expected = [[oracle.interfaced_lambertian(a, b, (width, width), n, k, normals, masking == "v-groove")
                 for a, b in few] for n, k in zip(ETA, ALBEDO, strict=True)]  # fmt: skip
    np.testing.assert_allclose(body(model, width, LIGHT, VIEWER)[:, :4], expected, rtol=5e-3)
    assert not np.allclose(body(model, 1.1 * width, LIGHT, VIEWER)[:, :4], expected, rtol=5e-3)


ERRORS = {  # median and 95th percentile of the fast sum's relative error at widths 0.2, 0.6 and 1.0
    "beckmann": ((1e-4, 2e-3), (5e-3, 3.5e-2), (6e-2, 0.12)),
    "ggx": ((1.1e-2, 2.6e-2), (1.3e-2, 7e-2), (6e-2, 0.12)),
    "gaussian": ((3e-3, 7e-3), (9e-3, 6e-2), (6e-2, 0.12)),
}


@every
def test_the_fast_sum_is_as_near_as_it_says(normals, masking):
    for width, (typical, most) in zip((0.2, 0.6, 1.0), ERRORS[normals], strict=True):
        fast, slow = (body(kind(normals, masking), width, LIGHT, VIEWER) for kind in (InterfacedLambertian, ManyFacets))
        away = np.abs(fast / slow - 1)
        assert np.median(away) < typical
        assert np.quantile(away, 0.95) < most
    assert away.max() > 1e-3, "the two are not the same"


@every
def test_the_fast_sum_does_not_jump_with_the_width(normals, masking):
    found = np.array(
        [body(InterfacedLambertian(normals, masking), w, LIGHT, VIEWER) for w in np.linspace(0.40, 0.46, 13)]
    )
    assert np.max(np.abs(np.diff(np.log(found), axis=0))) < 0.03


@every
def test_light_and_viewer_may_be_exchanged(normals, masking):
    model = InterfacedLambertian(normals, masking)
    there, back = (evaluate(model, values(model, 0.3), from_vectors(*x)) for x in ((LIGHT, VIEWER), (VIEWER, LIGHT)))
    np.testing.assert_allclose(there, back, rtol=1e-9)


@every
def test_without_roughness_it_is_a_smooth_plastic(normals, masking):
    model = InterfacedLambertian(normals, masking)
    under = jax.jit(plastic)(LIGHT[:, 2], VIEWER[:, 2], ETA[:, None], ALBEDO[:, None])
    np.testing.assert_allclose(body(model, 1e-3, LIGHT, VIEWER), under, rtol=2e-3)


@every
def test_without_a_substrate_it_is_the_surface(normals, masking):
    model = InterfacedLambertian(normals, masking)
    given, g = values(model, 0.3, albedo=np.zeros(3)), from_vectors(LIGHT, VIEWER)
    np.testing.assert_allclose(evaluate(model, given, g), evaluate(model.surface, given, g), rtol=1e-12)


@pytest.mark.parametrize("sigma", [0.02, 0.3, 1.0])
def test_gaussian_normals_are_the_printed_ones_and_normalised(sigma):
    """IL Eq. 13, C by quadrature."""
    surface = InterfacedLambertian("gaussian", "v-groove").surface
    shape = lambda t: np.exp(-(t**2) / (2 * sigma**2))  # noqa: E731
    constant = 1 / quad(lambda t: 2 * np.pi * shape(t) * np.sin(t), 0, np.pi / 2, points=[min(5 * sigma, 1.5)])[0]
    theta = np.array([1e-3, 0.2, 0.7, 1.3])
    ours = np.asarray(jax.jit(surface.D)(theta, {"roughness": sigma}))
    np.testing.assert_allclose(ours, constant * shape(theta) / np.cos(theta), rtol=1e-8)


def test_the_surface_of_gaussian_normals_is_that_of_the_formula():
    model = InterfacedLambertian("gaussian", "v-groove")
    found = np.asarray(evaluate(model, values(model, 0.3, albedo=np.zeros(3)), from_vectors(LIGHT, VIEWER)))
    constant = 1 / quad(lambda t: 2 * np.pi * np.exp(-(t**2) / 0.18) * np.sin(t), 0, np.pi / 2)[0]
    for k, (a, b) in enumerate(zip(LIGHT, VIEWER, strict=True)):
        h = (a + b) / np.linalg.norm(a + b)
        D = constant * np.exp(-(np.arccos(h[2]) ** 2) / 0.18) / h[2]
        grooves = microfacets.v_groove(a, b, h)
        expected = [microfacets.reflectance(a, b, n, 0.0) * D * grooves / (4 * a[2] * b[2]) for n in ETA]
        np.testing.assert_allclose(found[:, k], expected, rtol=1e-8)
        printed = [x * a[2] * b[2] / ((a @ h) * (b @ h)) for x in expected]
        assert not np.allclose(found[:, k], printed, rtol=1e-3), "IL Eq. 3 as printed"


def test_without_an_interface_it_is_oren_and_nayars_integral():
    """Their facets, masking and distribution; their interreflection, which is of second order in albedo, taken out."""
    model = ManyFacets("gaussian", "v-groove")

    def matte(albedo):
        given = {"roughness": 0.4, "albedo": np.full(3, albedo)}
        return np.asarray(evaluate(Cavities(), given, from_vectors(LIGHT, VIEWER)))

    direct = 4 * matte(0.5) - matte(1.0)  # of albedo 1
    ours = body(model, 0.4, LIGHT, VIEWER, eta=np.full(3, 1.0 + 1e-9), albedo=np.ones(3))
    np.testing.assert_allclose(ours, direct, rtol=5e-3)
    assert not np.allclose(ours, matte(1.0), rtol=5e-3), "interreflection counts"


@every
def test_gradients_are_finite_along_the_normal_and_at_grazing_angles(normals, masking):
    up, low = direction(0.0, 0.0), direction(1.5, 0.3)
    g = from_vectors(np.array([up, up, low, low]), np.array([up, low, low, low * [-1, -1, 1]]))
    model = InterfacedLambertian(normals, masking)
    slopes = jax.jit(jax.jacfwd(lambda v: evaluate(model, v, g)))(values(model, 0.3))
    for slope in jax.tree.leaves(slopes):
        assert np.all(np.isfinite(slope))


def test_transmittance_is_one_less_fresnels_reflectance():
    """Values and derivatives, up to the horizon and an index of 1."""
    cos, n = np.meshgrid(np.linspace(0, 1, 41), [1.0, 1 + 1e-6, 1.2, 1.5, 4.0])

    def with_slopes(f):
        """Values and derivatives by cosine and index, as one program."""

        @jax.jit
        def found(cos, n):
            one, zero = jnp.ones_like(cos), jnp.zeros_like(cos)
            return f(cos, n), *(jax.jvp(f, (cos, n), along)[1] for along in ((one, zero), (zero, one)))

        return lambda *at: map(np.asarray, found(*at))

    ours, right = with_slopes(through), with_slopes(lambda cos, n: cos * (1 - fresnel_of_dielectric(cos, n)))
    (found, *slopes), (expected, *right_slopes) = ours(cos, n), right(cos, n)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    inside = (cos > 0) | (n > 1 + 1e-9)  # at the corner there is no derivative by n
    for slope, other in zip(slopes, right_slopes, strict=True):
        assert np.isfinite(slope).all()
        np.testing.assert_allclose(slope[inside], other[inside], rtol=1e-9, atol=1e-11)
    low = np.geomspace(1e-12, 1e-5, cos.size).reshape(cos.shape)
    (found, *slopes), (expected, *_) = ours(low, np.ones_like(low)), right(low, np.ones_like(low))
    assert np.isfinite(slopes).all()
    np.testing.assert_allclose(found, expected, atol=1e-7)


@every
def test_derivatives_by_directions_are_those_of_the_sum(normals, masking):
    """A fit moves parameters only; the rule for derivatives knows of directions too."""
    model, (i, o) = InterfacedLambertian(normals, masking), pairs(20)
    given, step = values(model, 0.3), 1e-6
    of = lambda turn: evaluate(model, given, from_vectors(i, o @ turned(turn)))  # noqa: E731
    at = jax.jit(lambda turn: jax.jvp(of, (turn,), (1.0,)))
    slope, (more, less) = at(0.0)[1], (np.asarray(at(turn)[0]) for turn in (step, -step))
    np.testing.assert_allclose(slope, (more - less) / (2 * step), rtol=1e-5, atol=1e-6)


def turned(angle):
    """About an axis across the normal."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([jnp.stack([c, 0 * c, s]), jnp.asarray([0.0, 1.0, 0.0]), jnp.stack([-s, 0 * c, c])])


def test_what_has_no_meaning_is_refused():
    with pytest.raises(ValueError, match="gaussian' need masking 'v-groove"):
        InterfacedLambertian("gaussian")
    with pytest.raises(ValueError, match="isotropic"):
        sampled_facets.draw_normals(jax.random.key(0), 10, (0.1, 0.2), "gaussian")
    with pytest.raises((ValueError, TypeCheckError), match="gaussian"):
        sampled_facets.body(
            jax.random.key(0), direction(0.1, 0.0), direction(0.3, 0.0), (0.1, 0.1), 1.5, 0.5, "gaussian"
        )


# --- By Monte Carlo

BOTH = (0.5, 0.5)  # roughness along x and y
BARELY = 1 + 1e-7  # an index that reflects nothing


@pytest.mark.parametrize("normals", ["beckmann", "ggx"])
@pytest.mark.parametrize("roughness", [(0.3, 0.3), (0.15, 0.5)], ids=str)
def test_drawn_facets_have_the_integral(normals, roughness):
    for k, (i, o) in enumerate(zip(*pairs(4), strict=True)):
        found = DRAWN(jax.random.key(k), i, o, roughness, 1.5, 0.6, normals=normals, count=200_000)
        expected = oracle.interfaced_lambertian(i, o, roughness, 1.5, 0.6, normals, grooves=False)
        found = sampled_facets.Estimate(*map(float, found))
        assert abs(found.mean - expected) < 4 * found.error + 2e-3 * expected
        assert found.error < 0.01 * expected
        turned = oracle.interfaced_lambertian(i, o, roughness[::-1], 1.5, 0.6, normals, grooves=False)
        assert roughness[0] == roughness[1] or abs(found.mean - turned) > 4 * found.error


@pytest.mark.parametrize(("normals", "index"), [("beckmann", 1.0), ("beckmann", 1.5), ("ggx", 1.5), ("gaussian", 2.0)])
def test_cavities_that_absorb_nothing_give_all_light_back(normals, index):
    for theta in (0.1, 1.2):
        light = direction(theta, 0.7)
        found, dark = (
            jax.tree.map(np.asarray, PATHS(jax.random.key(1), light, BOTH, index, albedo, 40_000, normals))
            for albedo in (1.0, 0.0)
        )
        whole = found.share.sum() + found.caught
        assert whole == pytest.approx(len(found.share), rel=1e-12 if index == 1.0 else 8e-3)
        assert found.caught < 3e-3 * whole
        assert np.all(found.direction[found.share > 0][:, 2] > 0)
        assert dark.share.sum() < 0.5 * len(dark.share), "an absorbing substrate"


def seen_of(*given):
    return sampled_facets.Estimate(*map(float, ON_SENSOR(*given)))


def test_paths_in_cavities_are_oren_and_nayars_integral():
    """Lambertian facets: one bounce is their direct light, two their interreflection."""
    light, albedo, half_angle = direction(0.6, 0.0), 0.9, 0.15
    found = PATHS(jax.random.key(2), light, BOTH, 1.0, albedo, 400_000, "gaussian", 8)
    for theta, phi in ((0.2, 0.0), (0.7, 0.1), (0.7, np.pi), (0.9, 2.0)):
        towards = direction(theta, phi)
        for most in (1, 2):
            seen = seen_of(found, towards, half_angle, (1, most))
            expected = oracle.cavities(light, towards, 0.5, albedo, 120, 180, most == 2)
            assert abs(seen.mean - expected) < 4 * seen.error + 0.01 * expected
            assert seen.error < 0.02 * expected


@pytest.mark.parametrize("albedo", [0.0, 0.9], ids=["surface", "both"])
def test_one_bounce_in_cavities_is_the_integral(albedo):
    """With an interface: where it mirrors, and where transmittance lets light out."""
    light, half_angle, model = direction(0.7, 0.0), 0.15, ManyFacets("beckmann", "v-groove")
    found = PATHS(jax.random.key(3), light, (0.4, 0.4), 1.5, albedo, 400_000, most=3)
    rng = np.random.default_rng(0)
    cos, turn = 1 - (1 - np.cos(half_angle)) * rng.uniform(size=60), rng.uniform(0, 2 * np.pi, 60)
    for theta, phi in ((0.7, np.pi), (0.4, 2.6), (0.9, 0.3)):
        towards = direction(theta, phi)
        seen = seen_of(found, towards, half_angle, (1, 1))
        x, y = direction(theta + np.pi / 2, phi), np.cross(towards, direction(theta + np.pi / 2, phi))
        cone = cos[:, None] * towards + np.sqrt(1 - cos**2)[:, None] * (
            np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y
        )
        given = values(model, 0.4, eta=np.full(3, 1.5), albedo=np.full(3, albedo))
        expected = np.mean(np.asarray(evaluate(model, given, from_vectors(np.tile(light, (60, 1)), cone)))[0])
        assert abs(seen.mean - expected) < 4 * seen.error + 0.03 * expected


def test_one_bounce_in_anisotropic_cavities_is_the_integral():
    """Facets without an interface, four times as rough along y; turned by a right angle they look different."""
    light, half_angle, roughness = direction(1.0, 0.1), 0.12, (0.15, 0.6)
    found = PATHS(jax.random.key(4), light, roughness, BARELY, 0.8, 400_000, most=3)
    for theta, phi in ((1.0, 0.1), (0.9, 3.3), (1.1, 3.1)):
        towards = direction(theta, phi)
        seen = seen_of(found, towards, half_angle, (1, 1))
        expected, turned_round = (
            oracle.interfaced_lambertian(light, towards, r, BARELY, 0.8, "beckmann", grooves=True)
            for r in (roughness, roughness[::-1])
        )
        assert abs(seen.mean - expected) < 4 * seen.error + 0.01 * expected
        assert abs(seen.mean - turned_round) > 4 * seen.error + 0.01 * expected, "the axes matter"
