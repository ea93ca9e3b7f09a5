"""Makes a scene of the triangles of a drawing."""

import numpy as np

from ....names import TextureAddressing
from ....scene import Scene
from ....texture.pyramid import TexturePyramid
from ..canvas.triangles import Triangles
from ..elements.context import Context


def make_scene(
    context: Context,
    triangles: Triangles,
    addressing: TextureAddressing,
    linear: bool,
) -> Scene:
    """Make a scene of the triangles of a drawing, which keep their order and share no vertices.

    - `context`: gives the background, white if it is None, and the images of the textures.
    - `triangles`: corners in pixels; colours in sRGB with straight alpha.
    - `addressing`: how texture coordinates map to texels.
    - `linear`: whether colours, background and textures are decoded from sRGB to linear light.

    Textures and corner colours are left out if no triangle needs them, and alpha if all colours are
    opaque and no image of a texture has an alpha channel.
    """
    colors = triangles.colors
    background = np.array(context.background or (1.0, 1.0, 1.0))
    if linear:
        # Imported here, since it loads an image library.
        from ....color import srgb_to_linear

        colors = np.concatenate([srgb_to_linear(colors[..., :3]), colors[..., 3:]], axis=-1)
        background = srgb_to_linear(background)
    # An image may have been read whose shape has no area, or is clipped away.
    images = context.assets.textures if (triangles.texture >= 0).any() else []
    if (colors[..., 3] == 1).all() and all(image.shape[-1] == 3 for image in images):
        colors = colors[..., :3]
    if (colors == colors[:, :1]).all():
        colors = colors[:, :1]
    textured = {}
    if images:
        textured = {
            "uv": triangles.uv,
            "texture_index": triangles.texture.astype(np.int32),
            "textures": TexturePyramid.build(images, "clamp", addressing, linear),
        }
    return Scene.from_soup(
        triangles.corners,
        colors,
        background=background.astype(np.float32),
        **textured,
    )
