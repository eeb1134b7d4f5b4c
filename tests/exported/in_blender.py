"""Run by a Python that has `bpy`: an exported script, or a glTF file, as a sphere in the studio.

python in_blender.py EXPORTED.blender.py|EXPORTED.gltf STUDIO.exr SIDE SAMPLES PICTURE.exr SCRIPT.blender.py
"""

import runpy
import sys

import bpy

given, studio, side, samples, out, script = sys.argv[1:]
exported = runpy.run_path(script, run_name="exported")
scene = exported["room"]()
if given.endswith(".gltf"):
    bpy.ops.preferences.addon_enable(module="io_scene_gltf2")
    bpy.ops.import_scene.gltf(filepath=given)
else:
    exported["sphere"](exported["material"]())
tree = scene.world.node_tree
around = tree.nodes.new("ShaderNodeTexEnvironment")
around.image = bpy.data.images.load(studio)
tree.links.new(around.outputs["Color"], tree.nodes["Background"].inputs["Color"])
scene.render.resolution_x = scene.render.resolution_y = int(side)
scene.cycles.samples, scene.cycles.pixel_filter_type = int(samples), "BOX"
kept = scene.render.image_settings
kept.file_format, kept.color_depth, kept.exr_codec = "OPEN_EXR", "32", "ZIP"
scene.render.filepath = out
bpy.ops.render.render(write_still=True)
