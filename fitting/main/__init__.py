"""Fit reflectance models to measured BRDFs; installed as the package ``merlfit`` itself.

    import merlfit

    fit = merlfit.fit("nickel.binary")
    print(fit)

Names are loaded when they are first used: importing merlfit does not wait for JAX.
"""

# pyright: reportMissingImports=false
# Once installed, this file lies beside fitting/, merl_io/ and model/.

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same for type checkers and editors, to whom this file lies beside fitting/ once installed
    from .fitting.api import Fit, fit, load, sample
    from .fitting.pipeline.draws import NoPicture
    from .fitting.posterior.chain import ChainError
    from .fitting.results.storage import ResultError
    from .fitting.settings.config import ConfigError
    from .merl_io.atomic import WriteError
    from .merl_io.binary import Measurement, MerlError, write
    from .merl_io.inputs import read
    from .model.geometry import Geometry
    from .model.reflectance import evaluate
    from .model.registry import models
    from .model.two_scale import TwoScale, two_scale

_HOMES = {
    "fitting.api": ("Fit", "fit", "load", "sample"),
    "fitting.settings.config": ("ConfigError",),
    "fitting.results.storage": ("ResultError",),
    "fitting.pipeline.draws": ("NoPicture",),
    "fitting.posterior.chain": ("ChainError",),
    "merl_io.atomic": ("WriteError",),
    "merl_io.binary": ("Measurement", "MerlError", "write"),
    "merl_io.inputs": ("read",),
    "model.geometry": ("Geometry",),
    "model.reflectance": ("evaluate",),
    "model.registry": ("models",),
    "model.two_scale": ("TwoScale", "two_scale"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}
__all__ = [
    "ChainError", "ConfigError", "Fit", "Geometry", "Measurement", "MerlError", "NoPicture", "ResultError", "TwoScale",
    "WriteError", "evaluate", "fit", "load", "models", "read", "sample", "two_scale", "write",
]  # fmt: skip


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever it is
    if name not in _HOME:
        raise AttributeError(f"module 'merlfit' has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
