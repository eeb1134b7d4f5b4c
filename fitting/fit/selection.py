"""Choosing between fits: which interface and body, and which weights.

**Interface and body.** The residuals alone cannot choose: they are worth few independent ones where the model errs
(docs/statistics.md), and the compressive weight hardly sees the dark parts of a metal, where a floor of stray light
halves the error that anybody sees. So the error of cube roots of the BRDF, which is how the eye weighs light and dark
(Bieron & Peers 2020), is taken as evidence of the same worth:

    score = N log J + N log E^2,

with J the cost with its prior (which keeps an index of 3 from passing for a plastic), E the cube-root error and N the
effective count. Kinds within `ALIKE` of the lowest score (strong evidence begins at 6, Kass & Raftery 1995), whose J
and E are no more than `MARGIN` times the best one's, describe the file alike: the simplest is taken, that which comes
first among the candidates, which are sorted by their number of parameters. One that gives back more light than it
receives comes after all others of these.

**Matter.** A complex index rises towards grazing incidence in ways that no dielectric's does, so that constants of no
matter (`plausible`: a bright body under a conductor, a conductor that hardly absorbs) describe a felt or
paper a little better. Where they have the lowest score, a dielectric is taken, unless the J or E of every dielectric is
more than `BEYOND` times theirs: 2.46 of a reconstructed red fabric, 2.2 of a green felt, at most 1.6 of the other
files that it was chosen on (docs/fitting.md); or its J is above `VAGUE`: of those files none leaves more than 0.03,
while a chrome wrap under a coloured film, of which a dielectric leaves half, has no index of matter.

**Richer models.** Sums (``--model auto``) are judged by what is seen: J times the square of the picture's error P, on
the coarse grid, and twice that where the highlight is lost; without a picture by J E^2. A clear coat and another
surface, with diffraction and without, are tried where a single model leaves more than `ENOUGH` of the energy or its
picture is off by more than `NEAR`; where `MUCH` is left or the picture is off by more than `VISIBLE`, the most
promising of all is added to, twice at most. One takes the single model's place only where its error
is at most `WORTH` times that of the single one, J is no more than `MARGIN` times its J, and the picture is the nearer
one. Of all whose error is within a factor of `LITTLE` of the lowest the one with the fewest numbers is taken. Constants
of no matter are never taken. Neither the score nor a criterion that counts numbers would do: N is small where a model
errs, so that nothing would be preferred just where another lobe is missing. The cube-root error would not do, either:
of silver-metallic-paint it is larger for flakes under a coat, whose spheres are off by 1.0, than for a single surface,
whose spheres are off by 4.1.

**Failures.** A fit that leaves too much of the file's energy fails (`Status.UNEXPLAINED`). It is taken only where all
do: in the cube roots the mirror of a coloured film counts for little, and a body without its mirror has a lower score.

**Weights.** ``adaptive`` keeps the fit with the nearest picture (`picture`) among those that keep the highlight.
"""

from collections.abc import Callable, Sequence

import numpy as np

from ..results import schema

ALIKE = 6.0
MARGIN = 1.05
VAGUE = 0.2  # J above which a fit says too little of a file to say what matter it is
BEYOND = 2.5  # times the J or E of what no matter has: so much worse may a dielectric be
PATIENCE = 2.0  # times the nearest picture of all: as much worse may one be that keeps the highlight
ENOUGH = 0.005  # of the weighted energy: a single model that leaves no more needs no other lobe, if its picture is near
NEAR = 0.5  # CIELAB distance of spheres, half of what is just noticeable
MUCH = 0.03  # of the weighted energy: one that leaves more may need several
WORTH = 0.6  # times the error of a single model, or less: a richer one that takes its place
LITTLE = 0.75  # times the error of a model with fewer numbers, or more: not worth those that another one has more
LOST = 2.0  # times the error, where the highlight is lost
FACTOR = 2.0  # a highlight that is off by more is lost
VISIBLE = 2.0  # CIELAB distance of spheres above which a fit does not look like its file
SEEN = 1.0  # CIELAB distance of spheres, just noticeable: by less a picture is as good


def nearest(tried: Sequence[tuple[float, float]]) -> int:
    """Which fit of one model to keep, of several with other weights.

    The nearest picture among those that keep the highlight; where none does, or only with a picture `PATIENCE` times
    worse than the nearest of all, the nearest of all. Where there are no pictures, the first that keeps the highlight.

    Args:
        tried: of each, the picture's error and the highlight, fitted over measured.
    """
    pictures, every = np.nan_to_num([picture for picture, _ in tried], nan=1e6), range(len(tried))
    best = int(np.argmin(pictures))
    kept = [k for k in every if not lost(tried[k][1]) and pictures[k] <= PATIENCE * pictures[best]]
    return min(kept, key=lambda k: pictures[k], default=best)


def lost(highlight: float) -> bool:
    """Whether a highlight, fitted over measured, is off by more than a factor of two."""
    return not 1 / FACTOR <= highlight <= FACTOR


def score(objective: float, cube_root: float, count: float) -> float:
    """N log J + N log E^2; lower is better.

    Args:
        objective: J. cube_root: E. count: effective sample count N, the same for all fits that are compared.
    """
    return float(count * (np.log(max(objective, 1e-30)) + 2 * np.log(max(cube_root, 1e-30))))


def bic(cost: float, numbers: int, count: float) -> float:
    """Bayesian information criterion N log J + P log N; lower is better, and 6 are strong evidence.

    Args:
        cost: J. numbers: P, of parameters over all channels. count: effective sample count N, the same for all fits
            that are compared.
    """
    return float(count * np.log(max(cost, 1e-30)) + numbers * np.log(max(count, 1.0)))


def least(bics: Sequence[float], pictures: Sequence[float], highlights: Sequence[float], numbers: Sequence[int]) -> int:
    """Which of some models is the least that explains a material.

    Of those that keep the highlight (of all, if none does) and whose picture is as good as the nearest one's, to
    `SEEN`: the one with the fewest numbers among those whose BIC is within `ALIKE` of the lowest, if there are any.
    """
    pictures = np.nan_to_num(pictures, nan=np.inf).tolist()
    kept = [k for k in range(len(bics)) if not lost(highlights[k])] or list(range(len(bics)))
    nearest_picture = min(pictures[k] for k in kept)
    seen = [k for k in kept if pictures[k] <= nearest_picture + SEEN]
    lowest = min(bics[k] for k in seen)
    return min((k for k in seen if bics[k] <= lowest + ALIKE), key=lambda k: (numbers[k], bics[k]))


def choose(
    objectives: Sequence[float],
    cube_roots: Sequence[float],
    scores: Sequence[float],
    matter: Sequence[bool] = (),
    dielectric: Sequence[bool] = (),
    explains: Sequence[bool] = (),
    excessive: Callable[[int], bool] = lambda _: False,
) -> int:
    """Which of some fits to take, listed with the simplest first.

    Args:
        matter: whether their constants may be those of matter. dielectric: whether they are no conductor's. explains:
            whether they explain the file, as a fit does that succeeds. Empty if nothing is known of that.
        excessive: whether one gives back more light than it receives; asked only of those that describe the file alike.
    """
    every = [k for k, some in enumerate(explains) if some] or list(range(len(scores)))
    scored = np.nan_to_num(scores, nan=np.inf)
    best = min(every, key=lambda k: scored[k])
    if matter:
        known = [k for k in every if matter[k] and (matter[best] or (dielectric[k] and objectives[k] <= VAGUE))]
        if own := [k for k in known if not beyond(best, k, objectives, cube_roots)]:
            every, best = own, min(own, key=lambda k: scored[k])
    near = [k for k in every if k == best or alike(k, best, objectives, cube_roots, scores)]
    return near[0] if len(near) == 1 else next((k for k in near if not excessive(k)), near[0])


def error_of(objective: float, look: float, highlight: float | None) -> float:
    """What richer models are judged by.

    Args:
        objective: J. look: error of the picture, or of cube roots where nothing is seen.
        highlight: fitted over measured.
    """
    return objective * look**2 * (LOST if highlight is not None and lost(highlight) else 1.0)


def errors_of(compared: Sequence[schema.Candidate]) -> list[float]:
    """The same of each that was compared; infinite for what has none."""
    seen = _seen(compared)
    return [np.inf if c.objective is None else error_of(c.objective, _look(c, seen), c.highlight) for c in compared]


def _seen(compared: Sequence[schema.Candidate]) -> bool:
    """Whether there are pictures; of one that ran away there may be none even so."""
    return any(c.picture is not None for c in compared)


def _look(one: schema.Candidate, seen: bool) -> float:
    """The error of its picture, or that of its cube roots where nothing is to be seen."""
    error = one.picture if seen else one.cube_root
    return np.inf if error is None else error


def promising(compared: Sequence[schema.Candidate], single: int, first: int) -> int:
    """Which model to add to: that with the lowest error of a single one and of those from ``first`` on."""
    errors = errors_of(compared)
    return min([single, *(k for k in range(first, len(compared)) if compared[k].of_matter)], key=lambda k: errors[k])


def choose_sum(
    single: int,
    beside: Sequence[int],
    compared: Sequence[schema.Candidate],
    numbers: Sequence[int],
    excessive: Callable[[int], bool] = lambda _: False,
) -> int:
    """Which of some richer models to take in place of a single one, or that one.

    Args:
        single: its number. beside: those of the others. numbers: how many of them every model has.
        excessive: as for `choose`.
    """
    errors, seen = errors_of(compared), _seen(compared)
    most, nearest_look = MARGIN * (compared[single].objective or np.inf), _look(compared[single], seen)
    kept = [k for k in beside if (compared[k].objective or 0.0) <= most and _look(compared[k], seen) < nearest_look]
    lowest = min((errors[k] for k in kept), default=np.inf)
    if not lowest <= WORTH * errors[single] or not np.isfinite(lowest):
        return single
    near = sorted((k for k in kept if errors[k] <= lowest / LITTLE), key=lambda k: (numbers[k], errors[k]))
    return near[0] if len(near) == 1 else next((k for k in near if not excessive(k)), near[0])


def beyond(one: int, other: int, objectives: Sequence[float], cube_roots: Sequence[float]) -> bool:
    """Whether one fit describes the file so much better than another that what is known of matter counts no more."""
    near = objectives[other] <= BEYOND * objectives[one] and cube_roots[other] <= BEYOND * cube_roots[one]
    return not near  # nor is what is not finite


def alike(
    one: int, other: int, objectives: Sequence[float], cube_roots: Sequence[float], scores: Sequence[float]
) -> bool:
    """Whether one fit describes the file about as well as another, or better: by score, and by J and E themselves."""
    near = objectives[one] <= MARGIN * objectives[other] and cube_roots[one] <= MARGIN * cube_roots[other]
    return near and scores[one] < scores[other] + ALIKE
