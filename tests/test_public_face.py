"""The public interface is unchanged: every public name, with the parameters that scripts rely on.

A parameter is written `*name` if it is keyword-only, and `name=` if it has a default. Removing a
name, a parameter or a default breaks scripts; new ones are added to the list.
"""

import inspect
from typing import Any

import softras2d as sr

FACE = """
Area: compositing=
Comparison: tolerance, max_difference, mean_difference, rmse, psnr, ssim, flip, differing_pixels,
    worst_pixels, difference, picture
Comparison.differing_share: property
Comparison.matches: property
Comparison.rows: self
Filter: pixel=, level=, anisotropy=, lod_bias=
FitResult: scene, image, psnr, ssim, history, settings, interrupted=, state=
FitResult.height: property
FitResult.load: path
FitResult.report: self
FitResult.save: self, path
FitResult.width: property
FitResult.write_report: self, path
Hard: samples=, fill_rule=, shading=, edge_gradients=
Hard.rate: property
PixelLayers: triangle, coverage, barycentric, scene, plan
Plan: height, width, coverage, filter, origin, capacity, side, effects, grid_bits=,
    lists_all=, on_overflow=
Plan.cannot_be_outgrown: property
Plan.capacity_of: self, triangles
Plan.grid: property
Plan.hard: property
Plan.holds: self, other
Plan.memory: property
Plan.tiling: property
Scene: positions, triangles, colors, background, uv=, texture_index=, textures=, depth=,
    inverse_w=
Scene.from_mesh: positions, triangles, *vertex_colors=, *triangle_colors=, *background=, *uv=,
    *texture_index=, *textures=, *depth=, *inverse_w=
Scene.from_soup: corners, colors, optional
Soft: width=, profile=, temperature=
TexturePyramid: texels, levels, border=, addressing=
TexturePyramid.build: images, border=, addressing=, linear=
TexturePyramid.channels: property
TexturePyramid.count: property
TexturePyramid.depth: property
TiledPlan: cut, origin, border, lists, plans, witness, has_gradients
TiledPlan.height: property
TiledPlan.memory: property
TiledPlan.plan_at: self, number
TiledPlan.triangles_of: self, number
TiledPlan.width: property
Visibility: triangle, scene, plan, overflow
Visibility.barycentric: property
Visibility.coverage: property
Visibility.depth: property
Visibility.footprint: self, triangle, barycentric, uv
camera.look_at: eye, target, up=
camera.perspective: fov_y_degrees, aspect, near, far
camera.project: vertices, triangles, *height, *width, *view, *projection, *model=,
    *vertex_colors=, *triangle_colors=, *uv=, *texture_index=, *textures=, *background=
check: scene
compare: actual, expected, *tolerance=
composite: visible, values, background=
fit: target, *triangles=, *family=, *solver=, *seed=, *steps=, *seconds=, *size=, *shading=,
    *translucent=, *softness=, *colors=, *loss=, *light=, *weights=, *start=, *palette=, *freeze=,
    *background=, *report=, *callback=, *resume=, *checkpoint=
fit_batch: targets, *triangles=, *solver=, *seed=, *steps=, *seconds=, *size=, *shading=,
    *translucent=, *softness=, *colors=, *loss=, *light=, *weights=, *start=, *palette=, *freeze=,
    *background=, *report=, *resume=, *devices=
fit_frames: images, *triangles=, *seed=, *steps=, *frame_steps=, *temporal=, *size=, *shading=,
    *translucent=, *softness=, *light=, *report=
interpolate: visible, attributes
keep_compiled_programs:
pad: scene
pictures.names:
pictures.path: name
pictures.size: name
pixel_layers: scene, plan, *layers
plan: scene, *height, *width, *coverage=, *filter=, *origin=, *max_width=, *grid_bits=, *capacity=,
    *headroom=, *on_overflow=
plan_for: *triangles, *height, *width, *coverage=, *filter=, *origin=, *max_width=, *grid_bits=
plan_tiles: scene, *height, *width, *coverage=, *filter=, *origin=, *tile=, *grid_bits=,
    *gradients=
plot.animate: path, frames, *seconds_per_frame=
plot.arrows: positions, vectors, *axes, *color=, *length=, *label=
plot.buffers: visible, *figure=
plot.convergence: results, *against=, *axes=
plot.difference: image, reference, *axes=, *limit=, *title=
plot.error: image, reference, *axes=, *limit=, *title=
plot.explore: draw, values, *name, *static
plot.film_strip: frames, *titles=, *columns=, *figure=
plot.id_colors: triangle
plot.pyramid: textures, index=, *figure=
plot.show: image, *axes=, *title=, *grid=, *inset=, *inset_zoom=
plot.triangles: scene, *axes, *color=, *width=, *vertices=
rasterize: scene, plan, *layers=
read_compact: path
read_image: path, *linear=
SvgControls: scene, points, controls, weights, linear, offset, constant_vertices, _document, _paths
SvgControls.matrix: self
SvgControls.moved: self, points
SvgControls.positions: self, points
SvgControls.text: self, points=
read_svg: path, *height=, *width=, *dialect=, *transform=, *assets=, *opacity=, *frame=,
    *linear=, *tolerance=, *strict=, *fit=
read_svg_controls: path, *height=, *width=, *transform=, *assets=, *opacity=, *linear=,
    *tolerance=, *strict=, *fit=
render: scene, plan
render_checked: scene, plan
render_tiles: scene, plan, *windows=, *devices=
resolve: visible, values, background=
sample_texture: textures, uv, footprint=, filter=, *texture_index=
simplify: scene, *height, *width, *filter=
testing.assert_image_matches: image, path, *tolerance=, *update=
tiled_value_and_grad: loss, *devices=
value_and_grad_replanning: loss, scene_of, *height, *width, *coverage=, *filter=, *headroom=,
    *has_aux=
view: subjects, *height=, *width=, *widget_height=
write_compact: path, scene, *height, *width, *steps_per_pixel=
write_image: path, image, *linear=, *truncate=
write_svg: path, scene, *height=, *width=, *fallback=, *digits=
write_svg_film: path, scenes, *height, *width, *seconds_per_frame=, *digits=, *smooth=
write_tiles: path, scene, plan, *devices=, *linear=, *truncate=, *report=
"""


def describe(value: Any) -> str:
    """The parameters of a callable, as in `FACE`; "property" for a property."""
    if isinstance(value, property):
        return "property"
    if isinstance(value, staticmethod | classmethod):
        value = value.__func__
    return ", ".join(
        ("*" if parameter.kind is parameter.KEYWORD_ONLY else "")
        + parameter.name
        + ("" if parameter.default is parameter.empty else "=")
        for parameter in inspect.signature(value).parameters.values()
    )


def look_up(path: str) -> Any:
    """The value of a dotted name; methods as in the `__dict__` of their class."""
    *containers, last = path.split(".")
    container = sr
    for name in containers:
        container = getattr(container, name)
    return vars(container)[last] if inspect.isclass(container) else getattr(container, last)


def listed_parameters() -> dict[str, str]:
    """The rows of `FACE`; an indented line continues the one before."""
    rows = FACE.strip().replace("\n    ", " ").splitlines()
    return {name: parameters.strip() for name, parameters in (row.split(":", 1) for row in rows)}


def test_public_names_have_the_listed_parameters():
    listed = listed_parameters()
    assert {name: describe(look_up(name)) for name in listed} == listed


def test_every_public_name_is_listed():
    assert set(sr.__all__) == {name.split(".")[0] for name in listed_parameters()}
