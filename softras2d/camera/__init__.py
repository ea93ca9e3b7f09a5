"""Projects triangles in space to a 2-D `Scene`: view and projection matrices, near-plane clipping.

`look_at` and `perspective` make matrices, and `project` applies them:

    scene = project(
        vertices, triangles, height=600, width=800,
        view=look_at(eye=(0, 1, 5), target=(0, 0, 0)),
        projection=perspective(fov_y_degrees=45, aspect=800 / 600, near=0.1, far=100),
        triangle_colors=colors,
    )

Matrices are 4x4, float64, and act on column vectors (x, y, z, 1): world space -> `view` -> view
space -> `projection` -> clip space.

- **View space** is right-handed: x right, y up. The viewer is at the origin and looks along -z.
- **Clip space** is (x, y, z, w). The image covers -w..w in x (right) and y (up). z is 0 on the near
  plane and w on the far plane.
- **Depth** is z / w: 0 on the near plane, 1 on the far plane, and grows away from the viewer.
- **Pixels** of the scene: x right, y down, as everywhere in the package.

All of it runs on the host, in numpy and float64, and has no derivatives.
"""

from .world_to_screen import look_at, perspective, project

__all__ = ["look_at", "perspective", "project"]
