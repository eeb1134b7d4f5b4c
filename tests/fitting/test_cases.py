"""Inputs of kinds that people met with other programs (../shared/cases): each is fitted with GGX to what is right."""

import pytest
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.settings.config import load


@pytest.fixture(scope="module")
def fitted(cases, tmp_path_factory):
    """Result of a file, by its name in the folder of cases."""
    config = load(model="ggx", posterior=False)
    return lambda name: fit_file(cases / name, tmp_path_factory.mktemp("fits"), config)


def close(result, **truth):
    """Whether parameters are what they should be, within two standard errors or 1 %."""
    found = {q.name: q for q in result.parameters}
    for name, value in truth.items():
        assert found[name].value == pytest.approx(value, rel=0.01, abs=2 * found[name].standard_error), name


def test_negative_values_are_data(fitted):
    """A dark signal was subtracted. Without what is negative the albedo comes out at 1.65e-3."""
    result = fitted("03/dark.csv")
    close(result, alpha=0.05, F0_550nm=0.04, albedo_550nm=6.28e-4)
    (albedo,) = (q for q in result.parameters if q.name == "albedo_550nm")
    assert albedo.standard_error < 1e-4
    assert result.fit.status == "CONVERGED"
