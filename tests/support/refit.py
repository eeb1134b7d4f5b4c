"""Fits that go on from another fit's optimum with other effects: what is compared is optima, not two searches."""

from merlfit.fitting.fit.levenberg_marquardt import solve
from merlfit.fitting.fit.problem import make_problem
from merlfit.fitting.fit.residuals import Objective
from merlfit.fitting.fit.transforms import layout_of
from merlfit.fitting.fit.weights import weighted_samples
from merlfit.fitting.pipeline import run, search
from merlfit.fitting.settings.config import parse
from merlfit.merl_io.binary import read
from merlfit.merl_io.samples import thin
from merlfit.model.measured import Measured

WHAT = (
    "Neural reconstructions of MERL materials (Sztrajman et al. 2021), not measurements: their sharp peaks are lower "
    "than measured, and a network may smooth away what the apparatus did. Cost of HP17 Eq. 56 relative to the "
    "measurement's weighted energy, RMSE in 1/sr"
)
STARS = "\\* not converged at the step limit, † no light at all would cost less: no global minimum"


class Material:
    """A MERL file, ready for several fits."""

    def __init__(self, path):
        self.measurement = read(path)
        self.samples = weighted_samples(self.measurement)
        self.whole = make_problem(self.samples)
        self.coarse = make_problem(thin(self.samples, search.COARSE), search.COARSE_AZIMUTHS)

    def searched(self, body, max_steps=40):
        """The fit of `merlfit fit` with default effects, one body and the index that is usual over it."""
        index = "complex" if body == "none" else "real"
        config = parse(
            {
                "effects": {"index": index, "body": body},
                "fit": {"max_steps": max_steps},
                "posterior": {"enabled": False},
            },
            "",
        )
        return run.fit(self.measurement, self.samples, config)

    def continued(self, fitted, model, coarse_steps=60, max_steps=20):
        """A fit of another model from where another one ended, coarse grid first; a material is seen as before."""
        layout = fitted.layout.with_material(model)
        if isinstance(model, Measured):
            layout = layout_of(model, fitted.layout.priors)
        near = solve(Objective(layout, self.coarse), layout.free(fitted.layout.values(fitted.solution.z)), coarse_steps)
        solution = solve(Objective(layout, self.whole), near.z, max_steps)
        return run.assess(layout, solution, self.measurement, self.samples)


def cost(solution_cost, converged):
    """A cost as the tables print it."""
    return f"{solution_cost:.4g}" + ("" if converged else "\\*") + ("†" if solution_cost > 1 else "")
