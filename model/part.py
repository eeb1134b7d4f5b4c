"""A part of a material: some of its lobes, with its body or without, to see by itself or to leave the rest out."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from .parameters import Parameter
from .reflectance import Factor, Lobes, Profile, Reflectance, Setting, Values


@dataclass(frozen=True)
class Part(Reflectance):
    """What is left of a material; what is not kept is no part of the compiled program.

    Attributes:
        material: the whole. kept: names of the sharp lobes that stay. with_body: whether the body does.
    """

    name: ClassVar[str] = "part"
    citation: ClassVar[str] = ""
    material: Reflectance
    kept: tuple[str, ...] = ()
    with_body: bool = True

    def __post_init__(self) -> None:
        """Refuse lobes that the material does not have."""
        if unknown := [lobe for lobe in self.kept if lobe not in self.material.lobes]:
            raise ValueError(f"{self.material} has no lobe {', '.join(unknown)}")

    @property
    def lobes(self) -> Mapping[str, Profile | None]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return {lobe: self.material.lobes[lobe] for lobe in self.kept}

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102
        return self.material.parameters

    @property
    def variant(self) -> str:  # noqa: D102
        return self.name

    def factors(self) -> Mapping[str, Factor]:  # noqa: D102
        return self.material.factors()

    def tables(self, scattered: bool = False) -> Mapping[str, Factor]:  # noqa: D102
        return self.material.tables(scattered)

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        lobes = self.material.assemble(at, s)
        sharp = {lobe: lobes.sharp[lobe] for lobe in self.kept}
        return Lobes(sharp, lobes.common if sharp else None, lobes.body if self.with_body else None)
