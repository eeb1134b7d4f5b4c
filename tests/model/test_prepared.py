"""What scattered directions share: tables give what each direction would compute for itself."""

import numpy as np
import pytest
from merlfit.model.measured import Measured
from merlfit.model.part import Part
from merlfit.model.registry import models
from merlfit.model.two_scale import TwoScale

from tests.support.compiled import evaluate, from_vectors, prepared

ALL = {
    "beta": 0.1, "p": 0.6, "b": 3.0, "c": 2.0, "sigma_s": 0.03, "n": np.array([1.9, 1.7, 1.6]),
    "k": np.array([3.6, 3.1, 2.4]), "eta": np.full(3, 1.5), "albedo": np.array([0.5, 0.2, 0.1]),
}  # fmt: skip
MODELS = (
    TwoScale(), TwoScale("plastic"), TwoScale(diffraction="off"), TwoScale(diffraction="lobe", renormalised=False),
    TwoScale("subsurface", diffraction="lobe", colour="fresnel"), TwoScale("lambert", split="conserving", order=16),
)  # fmt: skip


def directions(count=400, seed=0):
    x = np.random.default_rng(seed).normal(size=(2, count, 3))
    x[..., 2] = np.abs(x[..., 2])
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def values_of(model):
    usual = {q.name: np.full(3, q.default) if q.per_channel else q.default for q in model.parameters}
    return {name: ALL[name] if np.size(ALL.get(name, ())) == np.size(x) else x for name, x in usual.items()}


@pytest.mark.parametrize(
    "model",
    [*MODELS, Measured(TwoScale()), models()["he"](), models()["sgd-microfacet"](), models()["epd"]()],
    ids=repr,
)
def test_tables_give_what_each_direction_computes(model):
    g, values = from_vectors(*directions()), values_of(model)
    own = np.asarray(evaluate(model, values, g))
    looked_up = np.asarray(evaluate(model, prepared(model, values), g))
    np.testing.assert_allclose(looked_up, own, rtol=1e-3, atol=1e-9 * own.max())
    assert np.median(np.abs(looked_up - own) / np.maximum(own, 1e-300)) < 1e-5


def test_tables_in_single_precision():
    model, g = TwoScale("plastic"), from_vectors(*directions())
    single = {name: np.asarray(x, np.float32) for name, x in prepared(model, values_of(model)).items()}
    narrow = from_vectors(*directions().astype(np.float32))
    own = np.asarray(evaluate(model, values_of(model), g))
    np.testing.assert_allclose(np.asarray(evaluate(model, single, narrow)), own, rtol=2e-3)


def test_parts_add_up():
    g, model = from_vectors(*directions(50)), TwoScale("plastic", order=8)
    values = values_of(model)
    parts = [Part(model, ("specular",), False), Part(model, ("diffracted",), False), Part(model, (), True)]
    found = sum(np.asarray(evaluate(part, values, g)) for part in parts)
    np.testing.assert_allclose(found, np.asarray(evaluate(model, values, g)), rtol=1e-12)
    with pytest.raises(ValueError, match="no lobe haze"):
        Part(model, ("haze",))
