"""From vertices in space to a scene: the matrices of a viewer, the near plane, the viewport."""

from .world_to_screen import look_at, perspective, project

__all__ = ["look_at", "perspective", "project"]
