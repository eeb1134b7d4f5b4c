"""Every registered model goes through the same objective and the same solver."""

import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import directions, make_problem
from merlfit.fitting.fit.residuals import Objective, predict
from merlfit.fitting.fit.starts import start_hints, starting_points
from merlfit.fitting.fit.transforms import layout_of
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.model.geometry import Geometry
from merlfit.model.measured import Measured, profile
from merlfit.model.parameters import Parameter
from merlfit.model.reads import reads
from merlfit.model.reflectance import evaluate
from merlfit.model.registry import made, models
from merlfit.model.rivals.cook_torrance import CookTorrance
from merlfit.model.rivals.disney import Disney
from merlfit.model.rivals.ggx import GGX
from merlfit.model.rivals.gtr import GTR
from merlfit.model.rivals.interfaced_lambertian import InterfacedLambertian
from merlfit.model.rivals.k_correlation import KCorrelation
from merlfit.model.rivals.oren_nayar import OrenNayar
from merlfit.model.rivals.ward import Ward

from tests.oracles.facets import direction
from tests.support.plain_jacobian import difference, plain

UP = np.array([0.0, 0.0, 1.0])
MODELS = [kind() for kind in models().values()]
BLURRED = ("two-scale", "ggx", "hp15")  # by the apparatus: two lobes, one, and two of few parameters
MEASURED = [Measured(model, how) for model in MODELS for how in ("free", "derived") if model.name in BLURRED]
RIVALS = [m for m in MODELS if m.name != "two-scale"]
SUMS = [made("ggx+epd", {}), made("coat(ggx)+epd", {}), made("ggx+retro", {})]
UNUSUAL = [
    GGX("conductor"), GGX("dielectric", "v-groove"), GTR(gamma="1"), GTR("conductor", "v-groove"), CookTorrance("ngan"),
    OrenNayar(surface="none"), InterfacedLambertian("ggx", "v-groove"), InterfacedLambertian("gaussian", "v-groove"),
    Ward("ward"), Disney("remapped"), KCorrelation("lambert"),
]  # fmt: skip
F0, ALBEDO, A = (np.array(x) for x in ([0.9, 0.6, 0.3], [0.02, 0.1, 0.3], [30.0, 10.0, 2.0]))
TRUTH = {
    "ggx": {"alpha": 0.15, "F0": F0, "albedo": ALBEDO},
    "beckmann": {"roughness": 0.25, "F0": F0, "albedo": ALBEDO},
    "gtr": {"alpha": 0.15, "gamma": 1.5, "F0": F0, "albedo": ALBEDO},
    "sgd-microfacet": {"alpha": 0.1, "p": 0.9, "F0": F0, "albedo": ALBEDO},
    "epd": {"beta": 0.2, "p": 0.7, "F0": F0, "albedo": ALBEDO},
    "hp15": {
        "beta": 0.15, "p": 0.8, "a": 0.8, "k_s": np.array([0.8, 0.5, 0.4]), "F0": np.array([0.8, 0.5, 0.3]),
        "k_w": np.array([8e-3, 5e-3, 3e-3]), "diffuse_albedo": ALBEDO,
    },
    "grating": {
        "period": 0.8, "spread": 0.2, "higher": 0.2, "efficiency": np.array([0.2, 0.3, 0.25]), "diffuse_albedo": ALBEDO,
    },
    "smooth": {"B": 30.0, "C": 1.3, "eta": 1.6, "A": A, "diffuse_albedo": ALBEDO},
    "abc-microfacet": {"B": 60.0, "C": 1.6, "eta": 1.6, "A": A, "diffuse_albedo": ALBEDO},
    "cook-torrance": {"roughness": 0.25, "eta": 1.6, "albedo": F0, "diffuse_albedo": ALBEDO},
    "he": {"roughness": 0.4, "autocorrelation": 3.0, "eta": 1.6, "albedo": F0, "diffuse_albedo": ALBEDO},
    "sgd": {
        "alpha": np.array([0.1, 0.12, 0.15]), "p": np.array([0.5, 0.7, 0.9]), "albedo": np.array([0.8, 0.5, 0.3]),
        "F0": np.array([0.5, 0.3, 0.2]), "F1": np.array([0.1, 0.05, 0.02]), "Lambda": np.array([2.0, 3.0, 1.5]),
        "c": np.array([0.02, 0.05, 0.03]), "k": np.array([5.0, 7.0, 6.0]), "theta0": np.array([0.3, 0.2, 0.4]),
        "diffuse_albedo": ALBEDO,
    },
    "interfaced-lambertian": {"roughness": 0.3, "eta": np.array([1.4, 1.5, 1.6]), "albedo": np.array([0.7, 0.4, 0.1])},
    "ggx+epd": {
        "beta": 0.4, "p": 0.7, "share_2": 0.4, "alpha_2": 0.08, "F0": np.array([0.05, 0.2, 0.6]), "albedo": ALBEDO,
        "F0_2": np.array([0.5, 0.3, 0.1]),
    },
    "coat(ggx)+epd": {"beta": 0.4, "p": 0.7, "alpha_coat": 0.05, "eta_coat": 1.5, "F0": F0, "albedo": ALBEDO},
    "student-t": {"alpha": 0.15, "gamma": 2.4, "F0": F0, "albedo": ALBEDO},
    "ward": {"alpha": 0.25, "albedo": F0, "diffuse_albedo": ALBEDO},
    "blinn-phong": {"exponent": 40.0, "albedo": F0, "diffuse_albedo": ALBEDO},
    "ashikhmin-shirley": {"exponent": 40.0, "F0": F0, "albedo": ALBEDO},
    "lafortune": {"exponent": 15.0, "C": 1.05, "albedo": F0, "diffuse_albedo": ALBEDO},
    "retro": {"alpha": 0.3, "falloff": 1.5, "k_r": F0, "diffuse_albedo": ALBEDO},
    "abg": {"B": 0.01, "g": 1.6, "A": A / 100},
    "harvey-shack": {"L": 0.1, "s": 1.7, "b0": A},
    "k-correlation": {"B": 5.0, "s": 2.7, "sigma": np.array([0.03, 0.025, 0.02])},
    "disney": {
        "roughness": 0.4, "specular": 0.6, "specularTint": 0.3, "metallic": 0.2, "sheen": 0.5, "sheenTint": 0.4,
        "clearcoat": 0.6, "clearcoatGloss": 0.3, "subsurface": 0.3, "baseColor": np.array([0.6, 0.3, 0.1]),
    },
    "openpbr": {
        "specular_roughness": 0.5, "specular_ior": 1.5, "base_metalness": 0.2, "base_diffuse_roughness": 0.4,
        "coat_weight": 0.6, "coat_roughness": 0.25, "coat_ior": 1.7, "base_color": np.array([0.6, 0.3, 0.1]),
        "specular_color": np.array([0.9, 0.7, 0.4]), "coat_color": np.array([0.9, 0.6, 0.8]),
    },
    "ggx+retro": {
        "alpha_2": 0.15, "share_2": 0.4, "alpha": 0.3, "falloff": 1.5, "k_r": np.array([0.3, 0.5, 0.6]),
        "diffuse_albedo": ALBEDO, "F0_2": F0,
    },
    "oren-nayar": {"roughness": 0.4, "k_s": np.array([0.1, 0.05, 0.02]), "albedo": np.array([0.7, 0.4, 0.1])},
    "oren-nayar-qualitative": {"roughness": 0.5, "albedo": np.array([0.7, 0.4, 0.1])},
}  # fmt: skip
pytestmark = pytest.mark.usefixtures("compiled_quickly")


@pytest.fixture(scope="module")
def few():
    """A few hundred bins of three azimuths a row, as many as nodes: what is gathered are the bins themselves."""
    grid = merl_grid()
    weight = np.where(grid.above, grid.weight, 0.0) * np.ones((3, 1, 1, 1))
    return thin(fold(grid, np.ones_like(weight), weight), (9, 9, 30))


def of_model(model, samples, values):
    where = directions(samples.theta_h, samples.theta_d, samples.cos_i, samples.cos_o)
    return dataclasses.replace(samples, value=predict(model, values, where))


@pytest.mark.parametrize("model", [*MODELS, *MEASURED, *map(Measured, SUMS)], ids=lambda m: f"{m.name} {m}")
def test_normal_equations_are_those_of_the_plain_jacobian(model, few):
    layout, rng = layout_of(model), np.random.default_rng(5)
    samples = dataclasses.replace(few, value=rng.uniform(0.1, 1.0, few.value.shape))
    z = jnp.asarray(rng.normal(size=layout.size))
    found = Objective(layout, make_problem(samples)).normal_equations(z)
    assert difference(found, plain(layout, z, samples)) < 1e-12
    np.testing.assert_allclose(
        Objective(layout_of(model), make_problem(samples)).costs(layout.values(z)), found[:, -1, -1], rtol=1e-10
    )  # which does without derivatives


@pytest.fixture(scope="module")
def dense():
    """Enough bins for a lobe's tail and for grazing angles."""
    grid = merl_grid()
    weight = np.where(grid.above, grid.weight, 0.0) * np.ones((3, 1, 1, 1))
    return thin(fold(grid, np.ones_like(weight), weight), (3, 5, 30))


@pytest.mark.parametrize("model", [*RIVALS, *SUMS], ids=lambda m: m.name)
def test_truth_is_recovered(model, dense):
    """To a thousandth, by the pipeline's own starting points; where many values do the same, the BRDF."""
    layout, truth = layout_of(model), TRUTH[model.name]
    samples = of_model(model, dense, truth)
    samples = dataclasses.replace(samples, weight=samples.weight / np.maximum(samples.value, 1e-3))
    objective = Objective(layout, make_problem(samples))
    starts = starting_points([layout], start_hints(samples), objective.problem, 5)[0]
    found = min((solve(objective, z, 150) for z in starts), key=lambda s: s.cost)
    values = layout.values(jnp.asarray(found.z))
    if model.name in ("sgd", "disney"):
        again = of_model(model, dense, values).value
        counted = samples.weight > 0
        np.testing.assert_allclose(again[counted], samples.value[counted], rtol=2e-2)
        return
    assert found.converged
    assert found.cost < 1e-9
    for name, value in values.items():
        np.testing.assert_allclose(value, truth[name], rtol=1e-3, err_msg=name)


@cache
def at_edges(model):
    """The BRDF and its slopes where directions or parameters are at an edge, as a program of their positions."""
    up, flat, below = direction(0.0, 0.0), direction(np.pi / 2, 0.3), direction(2.0, 0.3)
    slanted = direction(1.0, 0.0)
    pairs = [(up, up), (slanted, slanted), (slanted, slanted * [-1, 1, 1]), (flat, up), (flat, flat), (below, up)]
    i, o = np.array(pairs).swapaxes(0, 1)
    brdf = lambda values: evaluate(model, values, Geometry.from_vectors(i, o))  # noqa: E731

    @jax.jit
    def found(positions):
        values = {q.name: jnp.asarray(q.between(positions[q.name])) for q in model.parameters}
        return brdf(values), jax.jacrev(brdf)(values)

    return found


@pytest.mark.parametrize("model", [*RIVALS, *SUMS, *UNUSUAL], ids=lambda m: m.variant)
@pytest.mark.parametrize("end", [0.0, 0.5, 1.0])
def test_values_and_slopes_are_finite_at_every_edge(model, end):
    positions = {q.name: np.full(3 if q.per_channel else (), end) for q in model.parameters}
    found, slopes = at_edges(model)(positions)
    assert found.shape == (3, 6)
    assert np.all(np.isfinite(found))
    assert np.all(found[:, -1] == 0), "light below the surface"
    for slope in jax.tree.leaves(slopes):
        assert np.all(np.isfinite(slope))


def test_what_a_model_may_not_declare_is_told():
    wrong = dataclasses.make_dataclass("Wrong", [], bases=(GGX,), frozen=True)
    wrong.parameters = property(lambda self: (Parameter("width", "w", "width", "1", 0.1, 0.01, 1.0),))
    with pytest.raises(ValueError, match="ggx: width has a logarithmic scale, but no prior"):
        layout_of(wrong())
    with pytest.raises(ValueError, match="ggx needs 3 values of F0, not 5"):
        evaluate(GGX(), {"alpha": 0.1, "F0": np.full(5, 0.1), "albedo": np.full(3, 0.1)}, Geometry.from_vectors(UP, UP))


def test_models_are_registered_by_name():
    assert next(iter(models())) == "two-scale"
    assert set(TRUTH) == {*models(), *(m.name for m in SUMS)} - {"two-scale"}
    for name, model in zip(models(), MODELS, strict=True):
        assert model.name == name
        assert "doi:" in model.citation or "https://" in model.citation
        assert hash(model) == hash(type(model)())
        assert len({q.name for q in model.parameters}) == len(model.parameters)
        read = set().union(*reads(model).parameters.values())
        assert read == {q.name for q in model.parameters}, "a parameter that nothing reads cannot be fitted"


@pytest.mark.parametrize("model", [m for m in MODELS if m.lobes], ids=lambda m: m.name)
def test_sharp_lobes_fall_with_theta_h(model):
    """What an exponent of the apparatus is derived from."""
    layout = layout_of(Measured(model, "derived"))
    profiles = jax.jit(lambda z: {lobe: profile(model, lobe, layout.values(z)) for lobe in model.lobes})
    for found in map(np.asarray, profiles(np.zeros(layout.size)).values()):
        assert found[0] > 0
        assert found[-1] < 0.5 * found[0]
        assert np.all(np.diff(found) <= 1e-9 * found[0])
