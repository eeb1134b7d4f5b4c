"""Run below a display (xvfb-run): an exported document as MaterialX's own renderer draws it, by GLSL.

python in_materialx.py EXPORTED.mtlx SPHERE.obj STUDIO.hdr IRRADIANCE.hdr SIDE SAMPLES PICTURE.npy
"""

import os
import sys

import MaterialX as mx
import MaterialX.PyMaterialXGenGlsl as mx_glsl
import MaterialX.PyMaterialXGenShader as mx_shader
import MaterialX.PyMaterialXRender as mx_render
import MaterialX.PyMaterialXRenderGlsl as mx_render_glsl
import numpy as np

path, mesh, studio, irradiance, side, samples, out = sys.argv[1:]
search, side = mx.getDefaultDataSearchPath(), int(side)
library = mx.createDocument()
mx.loadLibraries(mx.getDefaultDataLibraryFolders(), search, library)
document, lamps = mx.createDocument(), mx.createDocument()
mx.readFromXmlFile(document, path)
for each in (document, lamps):
    each.setDataLibrary(library)
valid, why = document.validate()
if not valid:
    raise SystemExit(f"{path}: {why}")
lamp = lamps.addNode("directional_light", "lamp", "lightshader")
lamp.setInputValue("direction", mx.Vector3(-0.45, -0.55, -0.7).getNormalized())
lamp.setInputValue("color", mx.Color3(1.0))
lamp.setInputValue("intensity", 2.0)
generator = mx_glsl.GlslShaderGenerator.create()
context = mx_shader.GenContext(generator)
context.registerSourceCodeSearchPath(search)
options = context.getOptions()
options.hwSpecularEnvironmentMethod = mx_shader.HwSpecularEnvironmentMethod.SPECULAR_ENVIRONMENT_FIS
options.hwMaxActiveLightSources, options.fileTextureVerticalFlip = 1, False
renderer = mx_render_glsl.GlslRenderer.create(side, side, mx_render.BaseType.FLOAT)
renderer.initialize()
images = mx_render_glsl.GLTextureHandler.create(mx_render.StbImageLoader.create())
renderer.setImageHandler(images)
lights = mx_render.LightHandler.create()
lights.setEnvRadianceMap(images.acquireImage(mx.FilePath(studio)))
lights.setEnvIrradianceMap(images.acquireImage(mx.FilePath(irradiance)))
lights.setEnvSampleCount(int(samples))
lights.registerLights(lamps, [lamp], context)
lights.setLightSources([lamp])
renderer.setLightHandler(lights)
shapes = renderer.getGeometryHandler()
shapes.addLoader(mx_render.TinyObjLoader.create())
shapes.loadGeometry(mx.FilePath(mesh), False)
camera, half = mx_render.Camera.create(), 0.1 * np.tan(np.radians(10))
camera.setViewportSize(mx.Vector2(side, side))
camera.setWorldMatrix(mx.Matrix44.createScale(mx.Vector3(1.0)))
camera.setViewMatrix(
    mx_render.Camera.createViewMatrix(mx.Vector3(0.0, 0.0, 6.0), mx.Vector3(0.0), mx.Vector3(0.0, 1.0, 0.0))
)
camera.setProjectionMatrix(mx_render.Camera.createPerspectiveMatrix(-half, half, -half, half, 0.1, 100.0))
renderer.setCamera(camera)
renderer.createProgram(generator.generate("sphere", document.getMaterialNodes()[0], context))
renderer.validateInputs()
renderer.render()
image = renderer.captureImage(None)
pixels = [[list(image.getTexelColor(x, y).asTuple())[:3] for x in range(side)] for y in range(side)]
np.save(out, np.array(pixels, np.float32))
os._exit(0)  # the display's library does not come to an end
