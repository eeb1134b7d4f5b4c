"""A scene as its TOML file describes it, checked: camera, lights, shapes, materials by name, tolerance."""

import os
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from ..merl_io.source import MerlError, toml

Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
MOST_PIXELS = 8192


class SceneError(MerlError):
    """A scene that cannot be rendered; the message is one line that names the file and what to mend."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


def _three(x: object) -> object:
    return (x, x, x) if isinstance(x, int | float) and not isinstance(x, bool) else x


Colour = Annotated[
    tuple[Annotated[float, Field(ge=0)], ...], Field(min_length=3, max_length=3), BeforeValidator(_three)
]


class Camera(_Part):
    """Where the picture is taken from; y is up unless ``up`` says otherwise."""

    position: Vector
    look_at: Vector = (0.0, 0.0, 0.0)
    up: Vector = (0.0, 1.0, 0.0)
    field_of_view_deg: Annotated[float, Field(gt=0, lt=170)] = 30.0
    """Angle that the picture's height spans."""
    width: Annotated[int, Field(ge=8, le=MOST_PIXELS)] = 256
    height: Annotated[int, Field(ge=8, le=MOST_PIXELS)] = 256

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        towards = np.subtract(self.look_at, self.position)
        if np.linalg.norm(np.cross(towards, self.up)) < 1e-9:
            raise ValueError("look_at should differ from position, and lie in another direction than up")
        return self


class Lamp(_Part):
    """A round lamp far away."""

    towards: Vector
    """Direction from the scene to the lamp, of any length."""
    irradiance: Colour = (3.14159, 3.14159, 3.14159)
    """On a surface that faces it, R, G, B or one number for all; pi makes a white surface send radiance 1."""
    radius_deg: Annotated[float, Field(ge=0, le=45)] = 0.25
    """Angular radius; the sun's is 0.27."""

    @model_validator(mode="after")
    def _is_somewhere(self) -> Self:
        if not any(self.towards):
            raise ValueError("towards should not be all zeros")
        return self


class Environment(_Part):
    """Light from everywhere."""

    kind: Literal["studio", "constant", "map"]
    """A studio with three windows, the same from everywhere, or a picture of latitude and longitude."""
    file: str | None = None
    """The map: .exr, .hdr or .npy, linear RGB, first row up; relative to the scene's file."""
    strength: Colour = (1.0, 1.0, 1.0)
    """Factor of the radiance, R, G, B or one number for all."""
    background: bool = False
    """Whether the camera sees it behind the shapes."""

    @model_validator(mode="after")
    def _map_has_a_file(self) -> Self:
        if (self.kind == "map") != (self.file is not None):
            raise ValueError("file is for kind = 'map', which needs it")
        return self


class Sphere(_Part):
    """A sphere."""

    centre: Vector = (0.0, 0.0, 0.0)
    radius: Positive = 1.0
    material: str


class Rectangle(_Part):
    """A rectangle, whose front is where across, up and the viewer form a right-handed frame; its back is black."""

    corner: Vector
    across: Vector
    up: Vector
    material: str

    @model_validator(mode="after")
    def _has_an_area(self) -> Self:
        if np.linalg.norm(np.cross(self.across, self.up)) < 1e-12:
            raise ValueError("across and up should span an area")
        if abs(np.dot(self.across, self.up)) > 1e-6 * np.linalg.norm(self.across) * np.linalg.norm(self.up):
            raise ValueError("across and up should be at right angles")
        return self


class Source(_Part):
    """A material: one of a fit's result, a measured file, and a model with its parameters."""

    result: str | None = None
    """RESULT.json of a fit, relative to the scene's file."""
    measured: str | None = None
    """MERL .binary file, relative to the scene's file."""
    model: str | None = None
    """Name of a model (`merlfit models`)."""
    settings: dict[str, Any] = {}
    """Settings of the model: of the two-scale model, its effects."""
    parameters: dict[str, float | list[float]] = {}
    """Values by name, of a model, lists of three for those per channel; or those to change of a result."""

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = [name for name in ("result", "measured", "model") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give one of result, measured and model, not {' and '.join(given) or 'none'}")
        if self.settings and self.model is None:
            raise ValueError("settings are for a material that names its model")
        if self.parameters and self.measured is not None:
            raise ValueError("a measured material has no parameters")
        return self


class Tolerance(_Part):
    """How far a picture with fewer effects may be from that with all: one of the two."""

    cielab: Positive | None = None
    """CIELAB distance of pixels as a screen shows them; 1 is just noticeable."""
    radiance: Positive | None = None
    """Difference of the radiance over that of the pixel, or over a hundredth of white where it is darker."""

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if (self.cielab is None) == (self.radiance is None):
            raise ValueError("give either cielab or radiance")
        return self


class Scene(_Part):
    """What is rendered. Light comes straight from lamps and environment, with shadows; surfaces light no others."""

    camera: Camera
    lamp: list[Lamp] = []
    environment: Environment | None = None
    sphere: list[Sphere] = []
    rectangle: list[Rectangle] = []
    materials: dict[str, Source]
    tolerance: Tolerance = Tolerance(cielab=1.0)
    white: Positive = 1.0
    """Radiance that is white in the picture."""
    samples: Annotated[int, Field(ge=1, le=65536)] = 64
    """Samples of each pixel."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0

    @model_validator(mode="after")
    def _something_to_see(self) -> Self:
        shapes = [*self.sphere, *self.rectangle]
        if not shapes:
            raise ValueError("there is no [[sphere]] and no [[rectangle]]")
        if not self.lamp and self.environment is None:
            raise ValueError("there is no light: add a [[lamp]] or an [environment]")
        if missing := sorted({each.material for each in shapes} - self.materials.keys()):
            raise ValueError(f"there is no [materials.{missing[0]}], which a shape is of")
        if unused := sorted(self.materials.keys() - {each.material for each in shapes}):
            raise ValueError(f"no shape is of [materials.{unused[0]}]")
        return self


def load(path: str | os.PathLike[str]) -> Scene:
    """Read and check a scene.

    Raises:
        SceneError: missing, no TOML, or not a scene.
    """
    path = Path(path)
    try:
        return Scene.model_validate(toml(path, "a scene", SceneError))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        said = first["msg"].removeprefix("Value error, ").replace("Input should be", "should be")
        said = {"extra_forbidden": "is no setting of a scene", "missing": "is missing"}.get(first["type"], said)
        raise SceneError(f"{path}: {where + ': ' if where else ''}{said}") from None
