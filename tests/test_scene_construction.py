"""Constructors of scenes compile no programs, and do not copy JAX arrays."""

import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

SQUARE = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], np.float32)


HALVES = np.array([(0, 1, 2), (0, 2, 3)])


CORNERS = SQUARE[HALVES]


class TestConstructorsCompileNothing:
    """A program for each new shape once took 8 ms and 1.4 MB: 1,342 MB after 200 drawings."""

    def test_scenes_of_many_sizes(self, count_compilations):
        image = np.full((5, 7, 4), 0.5, np.float32)
        with count_compilations() as compiled:
            for count in range(1, 12):
                corners = np.zeros((count, 3, 2), np.float32)
                textures = sr.TexturePyramid.build([image[: 1 + count % 5]])
                sr.Scene.from_soup(
                    corners, np.full((count, 3, 3), 0.5), background=[0.5, 0, 0], uv=corners,
                    texture_index=np.full(count, -1), textures=textures,
                    depth=np.zeros((count, 3)), inverse_w=np.ones((count, 3)),
                )  # fmt: skip
                sr.Scene.from_mesh(
                    np.zeros((count + 2, 2)), np.zeros((count, 3), int),
                    vertex_colors=np.zeros((count + 2, 4)).tolist(),
                )  # fmt: skip
        assert compiled.names == []

    def test_jax_arrays_are_used_without_a_copy(self, count_compilations):
        positions, triangles = jnp.asarray(SQUARE), jnp.asarray(HALVES, jnp.int32)
        colors, depth = jnp.ones((2, 1, 3)), jnp.zeros(4)
        vertex_colors = jnp.ones((4, 3))
        with count_compilations() as compiled:
            scene = sr.Scene.from_mesh(positions, triangles, triangle_colors=colors, depth=depth)
            sr.Scene.from_mesh(positions, triangles, vertex_colors=vertex_colors)
        assert compiled.names == []
        assert scene.positions is positions and scene.triangles is triangles
        assert scene.colors is colors and scene.depth is depth

    def test_later_changes_of_the_given_arrays_do_not_matter(self):
        """On a CPU, JAX would share the memory of an aligned NumPy array."""
        corners = np.zeros((4096, 3, 2), np.float32)
        colors = np.ones((4096, 1, 3), np.float32)
        scene = sr.Scene.from_soup(corners, colors)
        corners[:], colors[:] = 7, 7
        assert float(scene.positions.max()) == 0 and float(scene.colors.max()) == 1

    def test_traced_and_concrete_arrays_may_be_mixed(self):
        @jax.jit
        def shade(vertex_colors, triangles):
            scene = sr.Scene.from_mesh(SQUARE, triangles, vertex_colors=vertex_colors)
            return scene.colors.sum()

        assert float(shade(np.ones((4, 3), np.float32), HALVES)) == 18.0
        sparse = jax.jit(lambda triangles: shade(jnp.ones((4, 3)), triangles))
        assert float(sparse(HALVES)) == 18.0

        def total(scale):
            return sr.Scene.from_soup(CORNERS, [[scale, 0.0, 0.0]] * 2).colors.sum()

        assert float(jax.grad(total)(1.0)) == 2.0
