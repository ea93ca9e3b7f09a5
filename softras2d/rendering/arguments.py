"""Checks the arguments that `render`, `rasterize` and `pixel_layers` have in common."""

from typing import Any

from ..numerics.arguments import check_type
from ..planning.plan import Plan
from ..scene import Scene


def check_scene_and_plan(scene: Any, plan: Any) -> None:
    """Raise `ValueError` unless the arguments are a scene and a plan."""
    check_type("scene", scene, Scene)
    check_type("plan", plan, Plan, "softras2d.plan(scene, ...)")
