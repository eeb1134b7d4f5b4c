"""Results made by hand: what a fit would have written, without a fit."""

import jax.numpy as jnp
import numpy as np
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.pipeline.draws import chain_of
from merlfit.fitting.results import schema
from merlfit.fitting.results import storage as export
from merlfit.fitting.results.schema_posterior import sha1_of_draws
from merlfit.fitting.settings.config import Config
from merlfit.fitting.support.choices import EXPONENT
from merlfit.merl_io.bands import MERL
from merlfit.merl_io.binary import DIMS
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale

DEFAULTS = {q.name: jnp.asarray(q.default) for q in Measured(TwoScale("none")).parameters}  # now: it compiles something


def quantiles(value, width=0.1):
    return schema.Quantiles(q05=(1 - width) * value, q50=value, q95=(1 + width) * value)


def made(material="nickel", path="nickel.binary", model=None, posterior=None, sha1="0" * 40, succeeded=True):
    """A result with typical values; posterior: None, or whether it is sufficient."""
    model = model or Measured(TwoScale("none"))
    layout = layout_of(model)
    parameters = [
        schema.ParameterResult(
            name=name, parameter=q.name, symbol=q.symbol, channel=name[-1] if q.per_channel else None,
            meaning=q.meaning, unit=q.unit, value=q.default, laplace=quantiles(q.default, 0.2),
            quantiles=quantiles(q.default) if posterior else None, lower=q.lower, upper=q.upper, at_bound="no",
            prior=layout.prior(q), source=q.source,
        )
        for name, q in zip(layout.names, layout.entries, strict=True)
    ]  # fmt: skip
    return schema.Result(
        source=schema.Source(
            path=path, material=material, sha1=sha1, git_blob_sha1="0" * 40, genuine_merl=None, dims=DIMS,
            format="MERL",
            fraction_valid=0.9, outliers=0,
        ),
        model=schema.Model.of(
            model if isinstance(model, Measured) else Measured(model, "off"),
            DEFAULTS,
            MERL,
        ),
        parameters=parameters,
        fit=schema.Fit(
            status="CONVERGED" if succeeded else "STEP_LIMIT", message="converged", succeeded=succeeded, cost=0.02,
            cost_per_channel=[0.01, 0.005, 0.005], folding_scatter=0.001, steps=9, relative_offset=1e-6, bins=400_000,
            candidates=[], weights=EXPONENT,
        ),
        metrics=metrics(),
        posterior=None if posterior is None else posterior_part(layout, material, posterior),
        run=schema.Run(finished="2026-11-23T01:00:00+00:00", command=["merlfit", "fit", path]),
        seconds={"total": 2.5},
        seed=0,
        versions=export.versions(),
        config=Config().plain(),
    )  # fmt: skip


def metrics():
    """Every metric that there is."""
    return schema.Metrics(**{name: 0.1 for name, field in schema.Metrics.model_fields.items() if field.is_required()})


def posterior_part(layout, material, sufficient):
    each = [1.0] * layout.size
    return schema.PosteriorResult(
        sufficient=sufficient, message="long enough" if sufficient else "200 steps are 9 autocorrelation times",
        steps=200, walkers=32, acceptance=0.6, effective_bins=30.0, draws=600, pareto_k=0.2,
        coordinates=list(layout.coordinates), autocorrelation_steps=each, r_hat=each, bulk_size=each, tail_size=each,
        effective_size=each, contraction=each, chain_file=f"{material}.chain.npz",
        draws_sha1=sha1_of_draws(**made_draws(layout.size)),
    )  # fmt: skip


def made_draws(size):
    """Values and weights of the draws that a made posterior tells of."""
    return {"values": np.ones((5, size)), "weights": np.full(5, 0.2)}


def put_result(out, posterior=None, chain=None, name="nickel", **kind):
    """A result as a fit leaves it; chain: what is in the file beside it."""
    out.mkdir(exist_ok=True, parents=True)
    result = made(name, posterior=posterior, **kind)
    export.write_result(out / f"{name}.json", result)
    if chain is not None:
        chain_of(out / f"{name}.json").write_text(chain)
    return result
