"""What the JSON of a result tells programs: descriptions, covariance, priors, when and how it was computed."""

import json
import re
import sys
from datetime import UTC, datetime, timedelta

import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.identifiability import identifiability, priors
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.models import layout_for, two_scale
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.results import schema
from merlfit.fitting.settings.config import Config, parse
from merlfit.merl_io.binary import DIMS, write
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale
from scipy.stats import norm

from tests import result_schema
from tests.support.stand_ins import uncorrelated


def test_every_field_of_the_schema_is_described():
    found = result_schema.schema()
    for name, part in {"Result": found, **found["$defs"]}.items():
        for field, told in part["properties"].items():
            assert len(told.get("description", "")) > 5, f"{name}.{field}"
            assert not re.search(":[a-z]+:`", told["description"])


LAYOUT = layout_of(Measured(TwoScale("lambert")))


@pytest.fixture(scope="module")
def found():
    """Of random normal equations."""
    root = np.random.default_rng(0).normal(size=(3, LAYOUT.size + 1, 4 * LAYOUT.size))
    normal, z, cost = root @ root.transpose(0, 2, 1), jnp.linspace(-1, 1, LAYOUT.size), 5.0
    slopes = np.asarray(LAYOUT.slopes(z))
    noise = uncorrelated(normal, cost, 10.0)
    covariance = slopes @ noise.covariance @ slopes.T
    return covariance, identifiability(LAYOUT, noise, covariance)


def test_the_covariance_is_in_physical_units_and_agrees_with_the_correlations(found):
    covariance, told = found
    assert np.asarray(told.covariance) == pytest.approx(covariance)
    error = np.sqrt(np.diag(told.covariance))
    np.testing.assert_allclose(told.covariance / error / error[:, None], told.correlation, atol=1e-3)
    assert schema.Identifiability.model_validate_json(told.model_dump_json()) == told


def test_a_covariance_of_the_wrong_size_is_refused(found):
    data = found[1].model_dump()
    with pytest.raises(ValueError, match="entries, names"):
        schema.Identifiability.model_validate({**data, "covariance": data["covariance"][:-1]})
    with pytest.raises(ValueError, match="entries, coordinates"):
        schema.Identifiability.model_validate({**data, "priors": data["priors"][:-1]})


@pytest.mark.parametrize("effects", [Measured(TwoScale("lambert")), TwoScale("none")], ids=str)
def test_priors_for_programs_are_those_of_the_coordinates(effects):
    """The cut log-normal distribution function of the quantity, less its offset, is that of z."""
    layout = layout_of(effects)
    z = np.random.default_rng(1).normal(size=layout.size)
    flat = np.asarray(layout.flat(jnp.asarray(z)))
    values = dict(zip(layout.names, flat.tolist(), strict=True))
    for p, here, coordinate in zip(priors(layout), z, layout.coordinates, strict=True):
        assert p.parameter in layout.names
        x = values[p.parameter]
        if p.distribution == "uniform":
            assert norm.cdf(here) == pytest.approx((x - p.lower) / (p.upper - p.lower), rel=1e-6)
            continue
        if p.quantity == "sigma_rel":
            continue  # its share is an integral, `test_transforms.py` has it
        scale = {
            "half_width": lambda x: x * np.log(2) ** (1 / (2 * values["p"])),
            "odds": lambda x: x / max(1 - x, 1e-300),
            "dispersion": lambda x: (x - 1) / (values.get("eta_G", np.nan) - 1),
        }.get(p.quantity, lambda x: x)
        low, middle, high = (
            np.log(max(scale(v) - p.offset, 1e-300) / p.median) / np.log(p.factor) for v in (p.lower, x, p.upper)
        )
        share = (norm.cdf(middle) - norm.cdf(low)) / (norm.cdf(high) - norm.cdf(low))
        assert norm.cdf(here) == pytest.approx(share, rel=1e-5), (p, coordinate)


def test_a_prior_that_was_changed_is_told_as_it_is():
    changed = parse({"priors": {"b": {"median": 5.0, "factor": 2.0}}}, "here")
    told = {p.parameter: p for p in priors(layout_for(changed, two_scale(changed, ("complex", "none"))))}
    assert (told["b"].median, told["b"].factor, told["b"].quantity) == (5.0, 2.0, "b")
    assert told["c"].offset == 1.0


@pytest.mark.parametrize(
    ("words", "command"),
    [
        (["/usr/bin/merlfit", "fit", "x.binary"], ["merlfit", "fit", "x.binary"]),
        (["/lib/merlfit/__main__.py", "fit"], ["merlfit", "fit"]),
        (["-c"], []),
        (["/usr/bin/other", "fit"], []),
    ],
)
def test_when_and_how_a_result_was_computed(words, command, monkeypatch):
    monkeypatch.setattr(sys, "argv", words)
    told = schema.this_run()
    assert told.command == command
    at = datetime.fromisoformat(told.finished)
    assert at.utcoffset() == timedelta(0)
    assert abs(datetime.now(UTC) - at) < timedelta(minutes=1)


def test_equal_runs_differ_in_nothing_but_time(tmp_path):
    write(tmp_path / "dark.binary", np.zeros((3, *DIMS)))
    told = []
    for folder in ("a", "b"):
        fit_file(tmp_path / "dark.binary", tmp_path / folder, Config())
        data = json.loads((tmp_path / folder / "dark.json").read_text())
        assert datetime.fromisoformat(data.pop("run")["finished"])
        data.pop("seconds")
        told.append(data)
    assert told[0] == told[1]
