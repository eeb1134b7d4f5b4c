"""A fitted material as an object of Python: numbers, predictions, pictures, the posterior."""

import os
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jax.tree_util import register_pytree_node
from jax.typing import ArrayLike
from markupsafe import Markup
from matplotlib.figure import Figure

from ..merl_io.atomic import refused, write_bytes, write_text
from ..merl_io.binary import Measurement, MerlError
from ..merl_io.inputs import Input
from ..merl_io.scattered import vectors_of
from ..merl_io.source import PLAIN
from .pipeline.draws import NoPicture, chain_file, chain_of, own_chain, states
from .pipeline.editing import edited, edited_file
from .pipeline.place import claimed, place_of
from .pipeline.resampling import resample
from .results.schema import Metrics, Model, Quantiles, Result
from .results.storage import ResultError, write_result
from .show import style
from .show.inspection import file_of
from .show.lobes import INCIDENCES_DEG
from .show.parameter_table import as_html, as_latex, heads
from .show.pictures import PICTURES
from .show.prediction import Fitted, all_bins, predicted_lobe
from .show.subject import Subject, subject_of
from .show.terminal_tables import fitted_line, print_result
from .support.clock import Report, silent
from .support.compilation import use_cache
from .support.terminal import Screen, console
from .support.weighted import resampled

if TYPE_CHECKING:
    import anywidget
    import pandas  # pyright: ignore[reportMissingImports] - where it is installed
    import xarray  # pyright: ignore[reportMissingImports] - of the extra `arviz`

ROWS = ["name", "value", "low", "high", *Quantiles.model_fields, "unit", "fitted", "at_bound", "meaning"]
WIDTH = 118  # columns of a fit that is printed, at the most


class Values(dict[str, Any]):
    """Values of a fit; to set one of them would change a copy, and nothing that the fit predicts."""

    def __setitem__(self, name: str, value: object) -> None:
        raise TypeError(
            f'values of a fit are what was found; change a copy of them: {{**fit.parameters, "{name}": {value}}}'
        )

    def __reduce__(self) -> tuple[type, tuple[dict[str, Any]]]:
        return dict, (dict(self),)


def _plain(names: Any, values: Any) -> Any:  # noqa: ANN401 - as JAX has them
    return dict(zip(names, values, strict=True))


register_pytree_node(Values, lambda v: (tuple(v.values()), tuple(v)), _plain)  # a dictionary to what JAX compiles


class Fit:
    """A fitted material: parameters with their uncertainty, errors, predictions and pictures.

    Made by :func:`fit` and :func:`load`; ``print(fit)`` shows all that `merlfit inspect` does.

    Attributes:
        result: everything that goes into the JSON (docs/result.md).
        path: of that file.
    """

    def __init__(self, result: Result, path: Path, measured: Input | None = None) -> None:
        self.result = result
        self.path = path
        self._measured = measured
        self._folder: object = None  # whoever keeps it keeps the folder of a result that was given none (`api.fit`)

    @property
    def succeeded(self) -> bool:
        """Whether the parameters may be used."""
        return self.result.fit.succeeded

    @property
    def status(self) -> str:
        """How the fit ended: CONVERGED, AT_BOUND, STEP_LIMIT, UNEXPLAINED, NON_FINITE, NO_DATA, or EDITED since."""
        return self.result.fit.status

    @property
    def cost(self) -> float | None:
        """What is left of the weighted energy of the measurement (HP17 Eq. 56); None of a failed or edited one."""
        return self.result.fit.cost

    @property
    def metrics(self) -> Metrics:
        """Errors of the fit: RMSE, sMAPE, pictures and the highlight (docs/howto/metrics.md)."""
        return self.result.metrics

    @property
    def parameters(self) -> dict[str, Any]:
        """Values by name, arrays (C,) for those per channel, as :func:`merlfit.evaluate` takes them.

        What was found is not changed here: :meth:`edited` makes a material with other values, and
        ``{**fit.parameters, "beta": 0.2}`` is a copy to change. :meth:`table` has their intervals, bounds and units.
        """
        return Values(self.result.values())

    def edited(self, **values: ArrayLike) -> "Fit":
        """The same material with some parameters set to other values, which says that it is no fit.

        It has no errors, no posterior, and no intervals of what was changed; ``result.edited_from`` names the fit and
        what that had. It can be drawn, exported and saved (as ``NAME.edited.json``).

        Args:
            values: by name, as `parameters` has them (``n=[0.2, 0.9, 1.1]``, or one number for all channels), or as the
                JSON has them (``n_R=0.2``).

        Raises:
            merlfit.ConfigError: there is no such parameter, all channels share it, or its value is out of bounds.
            merlfit.ResultError: the fit failed, there is no material.
        """
        result = edited(self.path, self.result, values)
        found = Fit(result, edited_file(self.path) if result is not self.result else self.path, self._measured)
        found._folder = self._folder
        return found

    def table(self) -> "pandas.DataFrame | list[dict[str, Any]]":
        """One row a number of the model: a frame where pandas is installed, else a list of dictionaries.

        ``q05``, ``q50`` and ``q95`` are quantiles of the posterior, None without one; ``low`` and ``high`` the 90 %
        interval by the Laplace approximation, None at a bound and where the data do not decide; ``fitted`` is free,
        fixed or tied.
        """
        try:
            import pandas
        except ImportError:
            return self._rows()
        return pandas.DataFrame(self._rows(), columns=ROWS).set_index("name")

    def to_latex(self, path: str | os.PathLike[str] | None = None) -> str:
        """The parameters as a table of LaTeX (booktabs), without those of the apparatus: symbol, value with its 90 %
        interval above and below, unit; `merlfit table --format latex` has several results side by side.

        Args:
            path: a file to write it to, too.
        """
        text = as_latex([self.result])
        if path is not None:
            write_text(Path(path), text)
        return text

    def _rows(self) -> list[dict[str, Any]]:
        rows = []
        for q in self.result.parameters:
            low, high = (q.laplace.q05, q.laplace.q95) if q.laplace else (None, None)
            quantiles = q.quantiles.model_dump() if q.quantiles else dict.fromkeys(Quantiles.model_fields)
            rows.append({
                "name": q.name, "value": q.value, "low": low, "high": high, **quantiles,
                "unit": q.unit, "fitted": q.fitted, "at_bound": q.at_bound, "meaning": q.meaning,
            })  # fmt: skip
        return rows

    def brdf(self, i: ArrayLike, o: ArrayLike) -> np.ndarray:
        """BRDF of the fitted material (1/sr), shape (C, ...); 0 where light or viewer are below the surface.

        Args:
            i, o: unit vectors of light and viewer, (..., 3), in a frame whose third axis is the surface's normal.

        Raises:
            merlfit.ResultError: the fit failed, there is no material.
            ValueError: i or o is no unit vector.
        """
        return self._predicted(i, o, with_grazing_loss=False)

    def predict(self, i: ArrayLike, o: ArrayLike) -> np.ndarray:
        """What the apparatus measures of the material, as :meth:`brdf`: MERL's loses light at grazing angles."""
        return self._predicted(i, o, with_grazing_loss=True)

    def _predicted(self, i: ArrayLike, o: ArrayLike, *, with_grazing_loss: bool) -> np.ndarray:
        model, (light, viewer) = self._model(), (np.asarray(x, float) for x in (i, o))
        for name, vectors in (("i", light), ("o", viewer)):
            if vectors.shape[-1:] != (3,) or not np.allclose(np.linalg.norm(vectors, axis=-1), 1.0, atol=1e-6):
                raise ValueError(f"{name} should be unit vectors of shape (..., 3)")
        return predicted_lobe(Fitted.of(model, self.result.values()), light, viewer, with_grazing_loss)

    def residuals(self) -> np.ndarray:
        """Measured less predicted (1/sr), as the apparatus sees both; NaN where there is no datum.

        Returns:
            (C, 90, 90, 180), theta_h, theta_d and phi_d, of a MERL file, or of the grid that it has; (C, N) of N
            scattered directions.

        Raises:
            merlfit.MerlError: the fitted file is missing, or is another one now.
            merlfit.ResultError: the fit failed.
        """
        measured, fitted = self._file(), Fitted.tabled(self._model(), self.result.values())
        if isinstance(measured, Measurement):
            folded = all_bins(fitted, measured.dims)
            predicted = np.concatenate([folded, folded[..., ::-1]], -1)  # bins phi_d and pi - phi_d are reciprocal
        else:
            light, viewer = vectors_of(measured)
            predicted = predicted_lobe(fitted, light, viewer)
        return np.where(measured.valid, measured.values - predicted, np.nan)

    def _file(self) -> Input:
        """What was fitted, read again where this object was loaded."""
        if self._measured is None:
            self._measured = self.result.source.read(file_of(self.path, self.result))
        return self._measured

    def sample(self, max_steps: int | None = None, report: Report = silent) -> "Fit":
        """The same fit with its posterior sampled, or with its chain continued; its file holds the intervals then, too.

        Args:
            max_steps: of the chain, at the most.
            report: called with a few words on what is being done.

        Raises:
            merlfit.MerlError: the fitted file is missing, or is another one now.
            merlfit.ResultError: the fit failed, or its chain is missing.
            merlfit.ChainError: the chain is of another fit.
            merlfit.WriteError: it cannot be kept, or a command is writing there.
            RuntimeError: the sampler failed; the file is as it was.
        """
        use_cache()
        with claimed(self.path.parent, alone=False):
            result = resample(self.path, self.result, file_of(self.path, self.result), max_steps, report)
        found = Fit(result, self.path, self._measured)
        found._folder = self._folder
        return found

    def to_arviz(self) -> "xarray.DataTree":
        """The posterior as ArviZ has it, in groups.

        - ``posterior``: one chain of equally likely draws in units of physics, by parameter. The draws of a merlfit
          posterior are weighted; as many are drawn from them by systematic resampling, in no order of time: R-hat and
          effective sizes are its attributes, not what ArviZ would compute from these.
        - ``sample_stats``: their weights before, and their log likelihood on all bins.
        - ``walkers``: all states of the chains, in free coordinates (docs/statistics.md).
        - ``observed_data``: the file, if it is there.

        Raises:
            ImportError: arviz-base is not installed (``pip install 'merlfit[arviz]'``).
            merlfit.NoPicture: there is no posterior, or its chain is missing.
        """
        try:
            import arviz_base  # pyright: ignore[reportMissingImports] - of the extra `arviz`
        except ImportError:
            raise ImportError("to_arviz() needs arviz-base: pip install 'merlfit[arviz]'") from None
        chain = chain_file(self.result, self.path)
        weights = chain["weights"].ravel()
        taken = resampled(weights, len(weights))
        grouped: dict[str, list[np.ndarray]] = {}
        for k, q in enumerate(self.result.parameters):
            grouped.setdefault(q.parameter, []).append(chain["values"][taken, k])
        per_channel = {q.parameter for q in self.result.parameters if q.channel}
        groups = {
            "posterior": {n: np.stack(x, -1)[None] if n in per_channel else x[0][None] for n, x in grouped.items()},
            "sample_stats": {"weight": weights[taken][None]},
        }
        if "log_likelihood" in chain:  # which earlier versions did not keep
            groups["sample_stats"]["log_likelihood"] = chain["log_likelihood"][taken][None]
        dims = {name: ["channel"] for name in per_channel}
        if (walked := states(self.result, self.path)) is not None:
            groups["walkers"], dims["z"] = {"z": walked.swapaxes(0, 1)}, ["coordinate"]
        with suppress(MerlError):
            groups["observed_data"] = {"brdf": self._file().values}
            dims["brdf"] = ["channel"]
        posterior = self.result.posterior
        assert posterior is not None
        coordinates = {"channel": self._model().channels, "coordinate": posterior.coordinates}
        # a chain that was stopped may have more walkers than steps
        found = arviz_base.from_dict(groups, dims=dims, coords=coordinates, check_conventions=False)
        diagnostics = posterior.model_dump(include={"r_hat", "effective_size", "bulk_size", "tail_size", "pareto_k"})
        found["posterior"].attrs.update(diagnostics, message=posterior.message, coordinates=posterior.coordinates)
        return found

    def view(self, *others: "Fit", folder: str | os.PathLike[str] = ".") -> "anywidget.AnyWidget":
        """A widget for notebooks: spheres, lobes and a slider for each parameter, as `merlfit view` has them.

        Its ``values`` follow the sliders: ``fit.edited(**widget.values[0])`` is what is seen.

        Args:
            others: fits beside this one. folder: for what is saved.

        Raises:
            ImportError: anywidget is not installed (``pip install 'merlfit[view]'``).
            merlfit.NoPicture: a fit failed.
        """
        try:
            from .view.widget import View
        except ImportError:
            raise ImportError("view() needs anywidget: pip install 'merlfit[view]'") from None
        from .view.frames import Shown
        from .view.live import Live

        use_cache()
        shown = [Shown(each.path, each.result, each._measured) for each in (self, *others)]
        return View(Live(shown, Path(folder)))

    def plot(
        self, name: str, path: str | os.PathLike[str] | None = None, *, title: bool = False,
        **options: Any,  # noqa: ANN401 - of each picture
    ) -> Figure:  # fmt: skip
        """One of the pictures that `merlfit inspect` draws, as wide as a column of a paper (8.5 cm).

        Args:
            name: samples, scans, spheres, lobes, isolines, peak, residuals, errors, effects, corner, corner-all, trace.
            path: a PNG, PDF or SVG to write, too; what it is of stands in its metadata.
            title: whether that is above the picture, too. options: of lobes and corner (`plot_lobes`, `plot_corner`).

        Raises:
            KeyError: there is no such picture.
            merlfit.NoPicture: it needs the fitted file, which is missing or is another one now, or a posterior.
            merlfit.ResultError: the fit failed.
        """
        if name not in PICTURES:
            raise KeyError(f"{name!r} is none of {', '.join(PICTURES)}")
        self._model()
        use_cache()
        subject = subject_of(self.result, self.path, self._measured or file_of(self.path, self.result))
        if subject.result.posterior is not None and "chain" in subject.lacks:
            warnings.warn(f"no posterior is shown: {subject.lacks['chain']}", stacklevel=2)
        figure = PICTURES[name].draw(replace(subject, titled=title), **options)
        if path is not None:
            style.save(figure, Path(path))
        return figure

    def plot_lobes(
        self, path: str | os.PathLike[str] | None = None, *, theta: Sequence[float] = INCIDENCES_DEG,
        channels: Sequence[str] = (), models: Sequence["Fit"] = (), title: bool = False,
    ) -> Figure:  # fmt: skip
        """Lobes in the plane of incidence beside those of the file, with the bands of the posterior if there is one.

        Args:
            path: a PNG, PDF or SVG to write, too.
            theta: angles of the light to the normal (deg), a row of panels each.
            channels: by name, all by default; with ``models`` the middle one.
            models: other fits, whose lines are drawn beside this one's, with the data in black; without bands.
            title: whether the picture says above it what it is of; its metadata do in any case.

        Raises:
            merlfit.NoPicture: there is no such channel, in one of the models perhaps, or an angle is impossible.
        """
        beside: dict[str, Subject] = {}
        if models:
            every, own = [self, *models], self._model().channels
            drawn = channels or own[len(own) // 2 : len(own) // 2 + 1]
            for each in models:
                if missing := [name for name in drawn if name not in each._model().channels]:
                    raise NoPicture(f"{each.result.source.material}: has no channel {missing[0]!r}")
            names = heads([each.result for each in every], always=True)
            base = subject_of(self.result, self.path, self._measured or file_of(self.path, self.result))
            beside = {
                name: replace(base, result=each.result, chain=None, walkers=None)
                for name, each in zip(names, every, strict=True)
            }
        return self.plot("lobes", path, title=title, theta=theta, channels=channels, models=beside)

    def plot_corner(
        self, path: str | os.PathLike[str] | None = None, *, parameters: Sequence[str] = (), title: bool = False
    ) -> Figure:
        """Corner plot of the posterior: what all channels share, and the middle channel.

        Args:
            path: a PNG, PDF or SVG to write, too.
            parameters: these instead, in this order, as the JSON has them (``n_R``), or of all channels (``n``).
            title: as of `plot_lobes`.

        Raises:
            merlfit.NoPicture: there is no posterior, its chain is missing, or a parameter was not fitted.
        """
        return self.plot("corner", path, title=title, parameters=parameters)

    def plot_trace(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """How the walkers of the posterior moved: median and 90 % of them, step by step, in free coordinates."""
        return self.plot("trace", path)

    def plot_spheres(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Spheres under a lamp and under an environment: the file, the fit, and their CIELAB difference."""
        return self.plot("spheres", path)

    def plot_errors(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Maps over theta_h and theta_d: fit over file, and how far their cube roots are apart."""
        return self.plot("errors", path)

    def plot_isolines(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Isolines of the middle channel over all viewers, on the projected hemisphere, as HP17 Fig. 14."""
        return self.plot("isolines", path)

    def plot_effects(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """What reflection, diffraction and body add: spheres, lobes, shares of the light."""
        return self.plot("effects", path)

    def to_json(self, path: str | os.PathLike[str] | None = None) -> str:
        """The result as JSON, without the chain (docs/result.md); ``path``: a file to write it to, too."""
        if path is not None:
            write_result(Path(path), self.result)
        return self.result.model_dump_json(indent=2)

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write result and chain into a folder, as `merlfit fit` does; the path of the result, which is the fit's then.

        It is named after the material, ``NAME.json``; ``NAME.edited.json`` of an edited one.

        Where a result stands there that is of another file or model, or more complete, it stays, and a warning says
        in which folder beside it this one is; also where that was this fit's, and somebody sampled it since.

        Raises:
            merlfit.WriteError: it cannot be written, or a command is writing there.
        """
        folder, name = Path(folder), self.result.source.material
        if self.result.edited_from is not None:
            name = f"{name}.edited"
        with refused(folder, "made"):
            folder.mkdir(parents=True, exist_ok=True)
        with claimed(folder, alone=False), place_of(folder, name, alone=False) as place:
            own, chain = own_chain(self.result, self.path), chain_of(place.path)
            if own is None:
                chain.unlink(missing_ok=True)
            elif own.absolute() != chain.absolute():
                write_bytes(chain, own.read_bytes())
            self._write(place.path)
        self.path = place.path
        if place.said:
            warnings.warn(place.said, stacklevel=2)
        return self.path

    def _write(self, path: Path) -> None:
        if (posterior := self.result.posterior) is not None:
            posterior = posterior.model_copy(update={"chain_file": chain_of(path).name})
            self.result = self.result.model_copy(update={"posterior": posterior})
        write_result(path, self.result)

    def _model(self) -> Model:
        if self.result.model is None:
            raise ResultError(f"{self.path}: the fit failed ({self.result.fit.status}), it has no material")
        return self.result.model

    def __str__(self) -> str:
        shown = Screen(width=min(console.width, WIDTH), force_terminal=True, color_system=None, highlight=False)
        with shown.capture() as capture:
            print_result(shown, self.result)
        return capture.get()

    def _repr_html_(self) -> str:
        """What notebooks show: material, status, parameters with intervals, errors, cautions."""
        r = self.result
        said = Markup("<p><strong>{}</strong>: {}. <strong>{}</strong>: {}.</p>").format(
            r.source.material, "" if r.model is None else fitted_line(r.model), r.fit.status, r.fit.message
        )
        table = as_html([r]) if r.model is not None else ""
        return said + Markup(table) + Markup("").join(Markup("<p>Caution: {}</p>").format(x) for x in r.fit.cautions)

    def __repr__(self) -> str:
        return f"<Fit of {self.result.source.material}: {self.result.fit.status}, {self.path}>".translate(PLAIN)
