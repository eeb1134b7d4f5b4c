"""What is known of parameters beforehand: log-normal priors, by quantity. Settings are read from here: no jax."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LogNormal:
    """A log-normal prior: its median, and the factor of one standard deviation up or down."""

    median: float
    factor: float

    def __post_init__(self) -> None:
        """Refuse what is no distribution."""
        if not (self.median > 0 and self.factor > 1):
            raise ValueError(f"a median of {self.median:g} should be positive, a factor of {self.factor:g} above 1")


@dataclass(frozen=True)
class Priors:
    """The log-normal priors, by quantity; what is not here is uniform between its bounds.

    Attributes:
        half_width: tan(theta_h) where the distribution of normals has fallen to half, beta (ln 2)^(1/(2 p)): what one
            sees of a lobe, whatever its kurtosis. From a mirror (0.1 degrees) to cloth.
        p: kurtosis exponent; 1 is Beckmann's distribution, nickel's is 0.51 in HP15 Fig. 12.
        b: correlation length (um), from below the wavelengths to what is no longer nano-geometry.
        c: c - 1, of the falloff exponent.
        sigma_rel: height (um) of what diffracts into directions that exist, at normal incidence and the middle
            wavelength (HP17 Eq. 17): that is seen, and not sigma_s.
        n, k: of metals in visible light (silver's n is 0.05, rhodium's k 7).
        eta: eta - 1, of a coat or a plastic, in the middle channel.
        dispersion: ratio of what is alike in all channels, eta - 1, in another channel to that. Transparent matter
            disperses by a few per cent; the rest is for what white balance may be off.
        odds: of an albedo, albedo / (1 - albedo): from the floor under a metal, a few thousandths, to snow.
    """

    half_width: LogNormal = LogNormal(0.03, 5.0)
    p: LogNormal = LogNormal(0.8, 2.0)
    b: LogNormal = LogNormal(2.0, 4.0)
    c: LogNormal = LogNormal(0.7, 2.5)
    sigma_rel: LogNormal = LogNormal(0.03, 2.5)
    n: LogNormal = LogNormal(1.0, 3.0)
    k: LogNormal = LogNormal(2.0, 2.5)
    eta: LogNormal = LogNormal(0.5, 1.7)
    dispersion: LogNormal = LogNormal(1.0, 1.2)
    odds: LogNormal = LogNormal(0.11, 9.0)


PRIORS = Priors()


@dataclass(frozen=True)
class Constraint:
    """What a user says of one parameter; None is as the model declares it.

    Attributes:
        fixed: its value, or one for each channel: it is not fitted. start: where the first fit starts.
        lower, upper: bounds, within those of the model. tied: one value for all channels.
        prior: log-normal one of the parameter itself (less its offset), cut at the bounds.
    """

    fixed: tuple[float, ...] | None = None
    lower: float | None = None
    upper: float | None = None
    start: float | None = None
    prior: LogNormal | None = None
    tied: bool = False
