"""The models to fit, made of the settings."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

from ...merl_io.bands import MERL, Bands
from ...model.effects import FILMS, KINDS, TWO_SCALE, Kind
from ...model.measured import Measured
from ...model.reflectance import Reflectance
from ...model.rivals.epd import EPD
from ...model.rivals.grating import Grating
from ...model.sum import Sum, lowest, over
from ...model.two_scale import TwoScale
from ..fit.hints import hints_of
from ..fit.transforms import Layout, layout_of, refuse_contradictions
from ..settings.config import Config, ConfigError


def candidates(config: Config) -> list[Measured]:
    """Models to compare, those with the fewest parameters first; of the two-scale model every kind asked for."""
    kinds = _kinds(config) if config.model.with_two_scale else []
    found = {TWO_SCALE: [two_scale(config, kind) for kind in kinds]}
    found |= {material.name: _variants(config, material) for material in config.model.rivals}
    named = [model for name in config.model.names for model in _constrained(config, name, found[name])]
    return sorted(named, key=_numbers)


def with_sums(config: Config, *taken: Reflectance) -> list[Measured]:
    """What ``auto`` tries beside a single model: a clear coat over each kind, another surface beside it, and a film.

    With diffraction and without, of which two lobes have less need. Only kinds of its interface: with lobes enough a
    felt would pass for a metal, and with a film a paint for one.
    """
    single = taken[0]
    assert isinstance(single, TwoScale)
    kinds = [_two_scale(config, kind) for kind in _kinds(config) if kind[0] == single.index]
    bases = dict.fromkeys([*kinds, *(base.changed(diffraction="off") for base in kinds)])
    sums = [each for base in bases for each in (Sum(EPD(), base, coated=True), Sum(EPD(), base))]
    return _beside(config, [*sums, *(_filmed(config, single) if single.index == "complex" else [])])


def with_more(config: Config, *taken: Reflectance) -> list[Measured]:
    """What ``auto`` tries beside models that it has tried: a coat, a film, gratings, another surface.

    Much is left by these, so that a film is tried over any interface; it has to do more than a complex index does.
    """
    every: dict[Reflectance, None] = {}
    for model in taken:
        coat = model if isinstance(model, Sum) and model.coated else None
        below = coat.base if coat else model
        added = [] if isinstance(below, Sum) else [Sum(part, below) for part in (Grating(), EPD())]
        every |= dict.fromkeys(replace(coat, base=each) if coat else each for each in added)
        every |= {} if coat else {Sum(EPD(), model, coated=True): None}
        every |= dict.fromkeys(_filmed(config, model))
    return _beside(config, [*every])


def _filmed(config: Config, taken: Reflectance) -> list[Reflectance]:
    """The same with a film over the interface of the two-scale part, with and without a body."""
    base = lowest(taken)
    assert isinstance(base, TwoScale)
    if base.index == "film" or config.effects.index != "auto" or config.effects.fresnel != "exact":
        return []
    films = [two_scale(config, kind).material for kind in FILMS if config.effects.body in ("auto", kind[1])]
    return [over(taken, film) if isinstance(taken, Sum) else film for film in films]


def _beside(config: Config, materials: Sequence[Reflectance]) -> list[Measured]:
    """Those that have all parameters of which the settings say something; there may be none."""
    models, wanted = [measured(config, each) for each in materials], config.parameters.keys()
    return sorted((m for m in models if wanted <= {q.name for q in m.parameters}), key=_numbers)


def _variants(config: Config, material: Reflectance) -> list[Measured]:
    """A rival; of a sum over the two-scale model one for each kind asked for."""
    try:
        hints_of(material)
    except ValueError as error:
        raise ConfigError(f"model.name: {error}") from None
    if not (isinstance(material, Sum) and isinstance(lowest(material), TwoScale)):
        return [measured(config, material)]
    bases = [two_scale(config, kind).material for kind in _kinds(config)]
    return [measured(config, over(material, base)) for base in bases]


def _constrained(config: Config, name: str, variants: list[Measured]) -> list[Measured]:
    """Those variants of a model that have all parameters of which the settings say something.

    Raises:
        ConfigError: there is none, or what is said cannot be kept.
    """
    wanted = config.parameters
    found = [model for model in variants if wanted.keys() <= {q.name for q in model.parameters}]
    if not found:
        known = sorted({q.name for model in variants for q in model.parameters})
        missing = [each for each in wanted if each not in known]
        said = f"has no parameter {missing[0]}" if missing else f"has no variant with all of {', '.join(wanted)}"
        raise ConfigError(f"parameters: {name} {said}; it has {', '.join(known)}")
    try:
        for q in (q for model in found for q in model.parameters if q.name in wanted):
            refuse_contradictions(q, wanted[q.name])
    except ValueError as error:
        raise ConfigError(f"parameters: {error}") from None
    return found


def _kinds(config: Config) -> list[Kind]:
    """Interfaces and bodies to compare, the simplest first."""
    given = config.effects.index, config.effects.body
    every = FILMS if given[0] == "film" else KINDS
    found = [kind for kind in every if all(g in ("auto", k) for g, k in zip(given, kind, strict=True))]
    return found or [("real", "none")]  # the only other one that `TwoScale` allows


def _numbers(model: Measured) -> int:
    """How many numbers its material's parameters are, of three channels."""
    return sum(3 if q.per_channel else 1 for q in model.material.parameters)


def two_scale(config: Config, kind: Kind) -> Measured:
    """The two-scale model to fit with one interface and body."""
    return measured(config, _two_scale(config, kind))


def _two_scale(config: Config, kind: Kind) -> TwoScale:
    own: dict[str, Any] = asdict(config.effects) | dict(zip(("index", "body"), kind, strict=True))
    del own["preset"]
    return TwoScale(**own)


def measured(config: Config, material: Reflectance) -> Measured:
    """A material as the apparatus sees it."""
    if not material.lobes:
        return Measured(material)
    loss = config.acquisition.grazing_loss
    return Measured(material, "free" if loss == "auto" else loss, config.apparatus)


def variant(config: Config, name: str, variant: str) -> Measured:
    """One of the models to compare.

    Raises:
        KeyError: it is not among them.
    """
    compared = candidates(config)
    for model in compared:
        if (model.material.name, model.variant) == (name, variant):
            return model
    raise KeyError(f"{name} {variant} is none of {', '.join(map(str, compared))}")


def layout_for(config: Config, model: Reflectance, bands: Bands = MERL) -> Layout:
    """The parameters of a model to fit, in the coordinates that the priors make.

    Raises:
        ConfigError: what the settings say of parameters cannot be kept.
    """
    own = {q.name for q in model.parameters}
    constraints = tuple((name, each) for name, each in config.parameters.items() if name in own)
    try:
        return layout_of(model, config.priors, bands, constraints)
    except ValueError as error:
        raise ConfigError(f"parameters: {error}") from None
