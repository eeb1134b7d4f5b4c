"""Scripts that make a material of Blender's nodes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...merl_io.atomic import write_text
from .xml_text import comment

INPUTS = {
    "base_color": "Base Color", "base_metalness": "Metallic", "specular_roughness": "Roughness", "specular_ior": "IOR",
    "base_diffuse_roughness": "Diffuse Roughness", "specular_color": "Specular Tint", "coat_weight": "Coat Weight",
    "coat_roughness": "Coat Roughness", "coat_ior": "Coat IOR", "coat_color": "Coat Tint",
}  # fmt: skip
"""What the node Principled BSDF calls OpenPBR's inputs. Weights that it lacks are 1 in all fits; darkening by the
coat, which it lacks, too, is in the base's colour (`principled.blender_inputs`)."""
SCRIPT = '''# {said}
"""Make the material in Blender, by its node Principled BSDF without light of several bounces between facets.

In Blender 4.3 or later: Scripting, Open, Run Script adds a sphere of it. Without a window it renders a sphere under a
lamp in an even room: blender --background --python THIS.py -- PICTURE.png, or, after pip install bpy (Python 3.11),
python THIS.py PICTURE.png.
"""

import math
import sys

import bpy

NAME = {name}
INPUTS = {{
{inputs}
}}


def material():
    """The node with the inputs above."""
    made = with_nodes(bpy.data.materials.new(NAME))
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    surface, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    surface.distribution = "GGX"
    surface.location.x = -300
    for key, value in INPUTS.items():
        surface.inputs[key].default_value = value
    links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    return made


def with_nodes(made):
    if bpy.app.version < (5, 0, 0):  # from then on there are always nodes
        made.use_nodes = True
    return made


def sphere(of):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=192, ring_count=96, radius=1)
    bpy.ops.object.shade_smooth()
    bpy.context.object.name = NAME
    bpy.context.object.data.materials.append(of)


def room():
    """A camera, a sun without breadth, and a world of even light, in a scene that has nothing else."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
    lamp.data.energy, lamp.data.angle = 2.0, 0.0
    lamp.rotation_mode = "QUATERNION"
    lamp.location = 0.45, -0.7, 0.55
    lamp.rotation_quaternion = lamp.location.to_track_quat("Z", "Y")
    eye = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    eye.location, eye.rotation_euler, eye.data.angle = (0.0, -6.0, 0.0), (math.pi / 2, 0.0, 0.0), math.radians(20)
    for each in (lamp, eye):
        scene.collection.objects.link(each)
    scene.camera, scene.world = eye, with_nodes(bpy.data.worlds.new("room"))
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = 0.3, 0.3, 0.3, 1.0
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 64, False
    scene.render.resolution_x = scene.render.resolution_y = 256
    scene.view_settings.view_transform = "Standard"
    return scene


def render(path):
    scene = room()
    sphere(material())
    kept = scene.render.image_settings
    kept.file_format = "OPEN_EXR" if path.endswith(".exr") else "PNG"
    if path.endswith(".exr"):
        kept.color_depth, kept.exr_codec = "32", "ZIP"
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    asked = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if bpy.app.background and asked:
        render(asked[-1])
    else:
        sphere(material())
'''


def to_blender(name: str, inputs: Mapping[str, Any], said: str, what: str, out: Path) -> Path:
    """A script of OpenPBR's inputs; ``what`` they are, in words."""
    lines = []
    for key, value in inputs.items():
        if key in INPUTS:
            numbers = [*value, 1.0] if isinstance(value, list) else [value]
            told = ", ".join(f"{x:.6g}" for x in numbers)
            lines.append(f'    "{INPUTS[key]}": {f"({told})" if isinstance(value, list) else told},')
    text = SCRIPT.format(said=comment(f"{said}: {what}"), name=repr(name), inputs="\n".join(lines))
    return write_text(out / f"{name}.blender.py", text)
