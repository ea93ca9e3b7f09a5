"""A script for a separate process with four host devices: it prints its measurements as JSON.

JAX fixes the number of devices when it starts, so tests cannot change it in their own process.
"""

import json
import re
from collections import Counter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import softras2d as sr

from .tiled import HEIGHT, TILE, WIDTH, joined, scene_of

_COLLECTIVE = re.compile(
    r"= \S+ (all-reduce|all-gather|all-to-all|collective-permute|reduce-scatter)(?:-start)?\("
)


def collectives(compiled: Any) -> dict[str, int]:
    """Count the collective operations in a compiled program, by name."""
    return dict(Counter(_COLLECTIVE.findall(compiled.as_text())))


def measure_batches(size: int) -> dict[str, Any]:
    """Compare a batch of eight scenes, split over four devices by `shard_map`, with one device."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(0, size, (8, 40, 3, 2)).astype(np.float32)
    colors = rng.random((8, 40, 3))
    scenes = [sr.Scene.from_soup(c, k) for c, k in zip(corners, colors, strict=True)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    plan = sr.plan(batch, height=size, width=size, coverage=sr.Hard(4))
    mesh = jax.make_mesh((4,), ("batch",), axis_types=(AxisType.Auto,))
    split = PartitionSpec("batch")
    sharded = jax.device_put(batch, NamedSharding(mesh, split))

    def draw(scene: sr.Scene) -> Any:
        return sr.render_checked(scene, plan)

    def loss_and_gradient(scenes: sr.Scene) -> Any:
        def loss(positions: Any) -> Any:
            moved = eqx.tree_at(lambda s: s.positions, scenes, positions)
            return jnp.sum(jax.vmap(draw)(moved)[0] ** 2)

        value, gradient = jax.value_and_grad(loss)(scenes.positions)
        return value, gradient

    def shard_loss_and_gradient(scenes: sr.Scene) -> Any:
        value, gradient = loss_and_gradient(scenes)
        return jax.lax.psum(value, "batch"), gradient

    def over_mesh(function: Any, result: Any) -> Any:
        shards = jax.shard_map(
            function, mesh=mesh, in_specs=split, out_specs=result, check_vma=False
        )
        return jax.jit(shards).lower(sharded).compile()

    images = over_mesh(jax.vmap(draw), split)
    gradients = over_mesh(shard_loss_and_gradient, (PartitionSpec(), split))
    drawn, overflow = images(sharded)
    expected, _ = jax.jit(jax.vmap(draw))(batch)
    value, gradient = gradients(sharded)
    expected_value, expected_gradient = jax.jit(loss_and_gradient)(batch)
    scale = np.abs(expected_gradient).max()
    return {
        "overflow": bool(np.any(overflow)),
        "images equal": bool(np.array_equal(drawn, expected)),
        "devices": len(drawn.sharding.device_set),
        "gradient error": float(np.abs(gradient - expected_gradient).max() / scale),
        "loss error": abs(float(value) / float(expected_value) - 1),
        "image collectives": collectives(images),
        "gradient collectives": collectives(gradients),
    }


def measure_partitioner(size: int) -> dict[str, int]:
    """Count the collectives that XLA inserts if a batch is split without `shard_map`."""
    corners = np.random.default_rng(0).uniform(0, size, (8, 40, 3, 2)).astype(np.float32)
    scenes = [sr.Scene.from_soup(c, np.zeros((40, 3))) for c in corners]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    plan = sr.plan(batch, height=size, width=size, coverage=sr.Hard(4))
    mesh = jax.make_mesh((4,), ("batch",), axis_types=(AxisType.Auto,))
    sharded = jax.device_put(batch, NamedSharding(mesh, PartitionSpec("batch")))
    draw = jax.jit(jax.vmap(lambda scene: sr.render_checked(scene, plan)))
    return collectives(draw.lower(sharded).compile())


def measure_tiles() -> dict[str, Any]:
    """Compare a tiled image and its gradient on four devices with one device."""
    scene = scene_of()
    arguments: dict[str, Any] = {"height": HEIGHT, "width": WIDTH, "coverage": sr.Soft(1.0)}
    plan = sr.plan_tiles(scene, tile=TILE, gradients=True, **arguments)
    devices = jax.devices()
    images = [joined(scene, plan, used) for used in (None, devices)]

    def squared(image: Any) -> Any:
        return jnp.sum(image**2)

    (value, gradient), (value_of_four, gradient_of_four) = (
        sr.tiled_value_and_grad(squared, devices=used)(scene, plan) for used in (None, devices)
    )
    equal = np.array_equal(gradient.positions, gradient_of_four.positions)
    return {
        "images equal": bool(np.array_equal(images[0], images[1])),
        "gradients equal": bool(equal) and value == value_of_four,
        "largest": float(np.abs(gradient.positions).max()),
    }


def measure_fits() -> dict[str, Any]:
    """Compare six fits on four devices with one device. The last shard is padded."""
    rng = np.random.default_rng(3)
    targets = [rng.random((24, 24, 3)).astype(np.float32) for _ in range(6)]
    arguments: dict[str, Any] = {"triangles": 8, "steps": 12, "seed": 1}
    alone = sr.fit_batch(targets, **arguments)
    shared = sr.fit_batch(targets, devices=jax.devices(), **arguments)
    return {
        "psnr": [result.psnr for result in alone],
        "psnr of four": [result.psnr for result in shared],
    }


def main() -> None:
    assert len(jax.devices()) == 4
    print(
        json.dumps(
            {
                "small": measure_batches(24),
                "large": measure_batches(96),
                "partitioner": [measure_partitioner(24), measure_partitioner(96)],
                "tiles": measure_tiles(),
                "fits": measure_fits(),
            }
        )
    )


if __name__ == "__main__":
    main()
