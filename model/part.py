"""A part of a material: some of its lobes, with its body or without, to see by itself or to leave the rest out."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from .parameters import Parameter
from .reflectance import Factor, Lobes, Reflectance, Setting, Values


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
    def lobes(self) -> tuple[str, ...]:  # noqa: D102 - as declared in `Reflectance`, like what follows
        return self.kept

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # noqa: D102
        return self.material.parameters

    def factors(self) -> Mapping[str, Factor]:  # noqa: D102
        return self._whole(self.material.factors())

    def tables(self, scattered: bool = False) -> Mapping[str, Factor]:  # noqa: D102
        return self._whole(self.material.tables(scattered))

    def _whole(self, functions: Mapping[str, Factor]) -> dict[str, Factor]:
        """Functions of the material, which look at its settings."""
        return {name: lambda v, s, f=f: f(v, s._replace(model=self.material)) for name, f in functions.items()}

    def assemble(self, at: Values, s: Setting) -> Lobes:  # noqa: D102
        found = self.material.assemble(at, s._replace(model=self.material))
        sharp = {lobe: found.sharp[lobe] for lobe in self.kept}
        return Lobes(sharp, found.common if sharp else None, found.body if self.with_body else None)

    @property
    def switches(self) -> Mapping[str, int]:  # noqa: D102
        return self.material.switches

    def ignored(self) -> frozenset[str]:  # noqa: D102
        return self.material.ignored()
