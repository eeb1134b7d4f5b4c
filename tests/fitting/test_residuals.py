"""The normal equations of a block: what is written to memory is what was computed, whatever the data are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.problem import Part, directions
from merlfit.fitting.fit.residuals import compact_normal_equations
from merlfit.model.materialised import materialised, true_of
from merlfit.model.two_scale import TwoScale

EFFECTS = TwoScale("none", "off")


def normal(target):
    """Of two directions and three channels, whose data are ``target``."""
    column = np.array([0.1, 0.2])[:, None, None]
    where = directions(column[:, 0, 0], np.array([0.3]), np.cos(column), np.cos(column))
    shape = (where.log_base.shape[0], 3, *where.log_base.shape[1:])
    part = Part(where, jnp.ones((*shape, 1)), jnp.full(shape, target))
    values = {q.name: jnp.full((3, 1, 1, 1) if q.per_channel else (), q.default) for q in EFFECTS.parameters}
    return np.asarray(compact_normal_equations(EFFECTS, values, part))


def test_data_that_are_no_numbers_do_not_become_zeros():
    sound, broken = normal(0.5), normal(np.nan)
    assert np.all(np.isfinite(sound))
    assert np.all(np.isnan(broken[:, -1, -1]))  # the cost
    np.testing.assert_array_equal(broken[:, :-1, :-1], sound[:, :-1, :-1])  # of the model alone


@pytest.mark.parametrize("number", [0.0, 1.0, -1.0, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_flag_is_true_of_every_number(number, kind):
    assert bool(jax.jit(true_of)(jnp.asarray(number, kind)))


def test_the_compiler_keeps_the_condition():
    def doubled(flag_of):
        twice = lambda x: materialised(lambda y: 2 * jnp.sin(y), flag_of(x[0]), x)  # noqa: E731
        return jax.jit(twice).lower(jnp.ones(3)).compile().as_text()

    assert "conditional(" in doubled(true_of)
    assert "conditional(" not in doubled(lambda x: ~(jnp.abs(x) < 0))  # which it knows to be true
