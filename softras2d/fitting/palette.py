"""Fit triangles in the colours of a palette: choose a colour for each triangle, and the palette.

Until the share `PALETTE_START` of a fit, the solver changes colours freely. Only in the scenes that
are shown or returned, each colour is replaced by the nearest colour of the palette. After that,
between chunks of steps, `quantize` assigns a colour of the palette to each triangle. If the user
gave only the number of colours, `quantize` also improves the palette. During a chunk the colours
are frozen, so that the solver moves triangles to where they are best *in these colours*.

Each pixel is a weighted sum of the colours, with weights of 0 or more that sum to at most 1. The
squared error, summed over pixels and channels, therefore has an upper bound that is a sum of
parabolas, one for the colour of each triangle. The bound is equal to the squared error at the
present colours. Each triangle takes the colour of the palette that is best for its parabola, as in
k-means. So, once all colours are of the palette, `quantize` never raises the squared error of an
opaque image, but for rounding. This is true for translucent triangles, too.

**Source:** Lloyd, *Least squares quantization in PCM* (1982); Arthur and Vassilvitskii, *k-means++*
(2007), for the first palette; De Pierro (1995) for the separable upper bound.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..numerics.device import to_device
from .solve import Residual
from .target import Target

Palette = Float[np.ndarray, "colors 3"]
"""The RGB colours that triangles may have, in 0..1."""

_SAMPLE_COUNT = 2**13
"""Number of pixels of the target, drawn at random, from which the first palette is made."""

_KMEANS_RUNS, _LLOYD_ROUNDS = 8, 20
"""Number of runs of k-means, the best of which gives the first palette; and rounds of each run."""

PALETTE_START = 0.6
"""Share of the fit after which triangles have colours of the palette.

Before that, the solver changes colours freely, because fits in the palette's colours from the start
end with a PSNR up to a decibel lower."""

_BOUND_COUNT, _ROUNDS_PER_BOUND = 2, 4
"""Number of times that a call of `quantize` computes the upper bound of the squared error; and, if
the fit chooses the palette, rounds of k-means for each bound."""

_LEAST_WEIGHT = 1e-6
"""Least curvature of the parabola that bounds the squared error as a function of a colour.

With less curvature, the present colour of a triangle counts as its best. The module explains the
parabolas. The curvature is about the number of pixels in which the triangle is visible."""


LEAST_CHANGE = 1 / 1024
"""Least change of a colour channel, for values in 0..1, that counts as a change.

With second-order solvers, the solve restarts after each change."""


class Quantized(NamedTuple):
    """The colours that `quantize` chose, each channel in 0..1.

    - `colors`: the colour of each triangle, spare ones included, which is one of the palette.
    - `palette`: the palette, which `quantize` has improved if it was told so.
    - `background`: a colour of the palette if `quantize` was told so, else the unchanged
      background.
    """

    colors: Float[np.ndarray, "triangles 3"]
    palette: Palette
    background: Float[np.ndarray, " channels"]

    def is_close(self, colors: Float[np.ndarray, "..."], palette: Palette) -> bool:
        """Whether the given colours and palette are nearly those of this object.

        All channels must differ by less than `LEAST_CHANGE`. `colors`: one colour for each
        triangle, in an array of any shape that ends with 3 channels.
        """
        change = np.abs(self.colors - np.asarray(colors).reshape(-1, 3)).max(initial=0.0)
        return bool(max(change, np.abs(self.palette - palette).max()) < LEAST_CHANGE)


def first_palette(target: Target, count: int, seed: int) -> Float[np.ndarray, "{count} 3"]:
    """Make a palette of `count` colours by k-means on the sRGB values of the target's pixels.

    A pixel counts in proportion to its weight and to its alpha. K-means runs several times on a
    random sample of the pixels, and the palette with the least sum of squared distances is
    returned. If the sample has fewer than `count` colours, some occur several times in the palette.
    `seed`: seed of the random choices.
    """
    rng = np.random.default_rng(seed)
    weight = np.ones(target.image.shape[:2]) if target.weights is None else target.weights
    if target.image.shape[-1] == 4:
        weight = weight * target.image[..., 3]
    share = weight.ravel().astype(np.float64) + 1e-12
    pixels = rng.choice(share.size, _SAMPLE_COUNT, p=share / share.sum())
    colors = target.image.reshape(-1, target.image.shape[-1])[pixels, :3].astype(np.float64)
    palettes = [_kmeans(rng, colors, count) for _ in range(_KMEANS_RUNS)]
    return min(palettes, key=lambda palette: _distances(palette, colors).sum())


def _kmeans(
    rng: np.random.Generator, colors: Float[np.ndarray, "n 3"], count: int
) -> Float[np.ndarray, "{count} 3"]:
    """Make a palette of `count` colours by one run of k-means on `colors`.

    The run starts from random colours, as k-means++ does: each is drawn with a probability in
    proportion to its squared distance from the nearest colour drawn before.
    """
    palette = colors[rng.integers(len(colors), size=1)]
    while len(palette) < count:
        distance = _distances(palette, colors) + 1e-12
        new = rng.choice(len(colors), p=distance / distance.sum())
        palette = np.concatenate([palette, colors[new : new + 1]])
    return _lloyd(palette, colors, np.ones(len(colors)), _LLOYD_ROUNDS)


def _distances(palette: Palette, colors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Squared distance, in RGB, of each colour from the nearest colour of the palette."""
    return ((colors - palette[nearest(palette, colors)]) ** 2).sum(1)


def palette_of(setting: Any, target: Target, seed: int) -> Palette | None:
    """Make the palette at the start of a fit from the value of the option `palette`, `setting`.

    `setting` is a list of RGB colours in 0..1; or a number of colours, for which `first_palette`
    makes the palette from the target; or None, for which the result is None. `seed`: seed of the
    random choices.
    """
    if setting is None:
        return None
    if isinstance(setting, int):
        return first_palette(target, setting, seed)
    return np.array(setting, np.float32)


def nearest(palette: Palette, colors: Float[np.ndarray, "colors_2 3"]) -> Int[np.ndarray, "..."]:
    """Index in the palette of the colour nearest to each given colour, by distance in RGB.

    The result has one index for each row of `colors`; of equal distances, the first counts.
    """
    palette = palette.astype(np.float64)
    return ((palette**2).sum(1) - 2 * colors @ palette.T).argmin(1)


def in_palette(palette: Palette, colors: Any) -> Float[Array, "..."]:
    """Replace each colour by the nearest colour of the palette, by distance in RGB.

    `colors`: an array of any shape that ends with 3 channels. The result has the same shape.
    """
    host = np.asarray(colors)
    return to_device(palette[nearest(palette, host.reshape(-1, 3))].reshape(host.shape))


def quantize(
    residual: Residual,
    y: Any,
    data: Any,
    target: Target,
    palette: Palette,
    *,
    improves_palette: bool,
    quantizes_background: bool,
) -> Quantized:
    """Assign a colour of the palette to each flat triangle, so that the squared error is low.

    The squared error is computed from sRGB values, multiplied by the weights of the pixels, and
    summed over pixels and channels, whatever the loss of the fit. For an opaque image whose colours
    are all of the palette already, the error does not rise, but for rounding. If
    `quantizes_background` is true, the background counts among these colours.

    - `residual`: the residual of the fit (`AbstractFit.residual`), of which only the image is used.
    - `y`: the unknowns, in which frozen numbers have their fixed values.
    - `data`: the second argument of `residual`, with None as its field `frozen`.
    - `target`: the premultiplied target and its weights, at the size of the fit.
    - `palette`: the present palette.
    - `improves_palette`: whether the palette is improved, too.
    - `quantizes_background`: whether the background gets a colour of the palette. It may be True
      for opaque images only.
    """
    weights = None if target.weights is None else to_device(target.weights, np.float32)
    image = to_device(target.image, np.float32)
    shape = y.colors.shape
    colors = np.asarray(y.colors, np.float64).reshape(-1, 3)
    background = np.asarray(data.background)
    for _ in range(_BOUND_COUNT):
        y = y._replace(colors=to_device(colors.reshape(shape), np.float32))
        data = data._replace(background=to_device(background, np.float32))
        gradients, curvatures = _parabolas(residual, y, data, image, weights)
        present = colors
        if quantizes_background:
            present = np.concatenate([colors, background[None].astype(np.float64)])
        else:
            gradients, curvatures = gradients[: len(colors)], curvatures[: len(colors)]
        weight = np.asarray(curvatures, np.float64).mean(1)
        step = np.asarray(gradients, np.float64) / np.maximum(weight, _LEAST_WEIGHT)[:, None]
        ideal = present - np.where((weight > _LEAST_WEIGHT)[:, None], step, 0.0)
        if improves_palette:
            palette = _lloyd(palette, ideal, weight, _ROUNDS_PER_BOUND)
        assigned = palette[nearest(palette, ideal)]
        colors = assigned[: len(colors)]
        if quantizes_background:
            background = assigned[-1]
    return Quantized(colors.astype(np.float32), palette, background.astype(np.float32))


def best_background(
    residual: Residual, y: Any, data: Any, target: Target
) -> Float[np.ndarray, "3"]:
    """Compute an RGB background, in 0..1, with which the squared error is at most the present one.

    It is the background that minimises the upper bound of the squared error in `quantize`. The
    image must be opaque. The arguments are as in `quantize`.
    """
    weights = None if target.weights is None else to_device(target.weights, np.float32)
    image = to_device(target.image, np.float32)
    gradients, curvatures = _parabolas(residual, y, data, image, weights)
    gradient, curvature = np.asarray(gradients[-1]), np.asarray(curvatures[-1])
    step = np.where(curvature > _LEAST_WEIGHT, gradient / np.maximum(curvature, _LEAST_WEIGHT), 0)
    return np.clip(np.asarray(data.background) - step, 0.0, 1.0).astype(np.float32)


@eqx.filter_jit
def _parabolas(
    residual: Residual,
    y: Any,
    data: Any,
    target: Float[Array, "height width channels"],
    weights: Float[Array, "height width"] | None,
) -> tuple[Float[Array, "colors 3"], Float[Array, "colors 3"]]:
    """Return the first and second derivatives of the parabolas that bound half the squared error.

    The module explains the bound. There is one parabola for each channel of each colour in `y`,
    and, in the last row, for each channel of the background. The derivatives are taken at the
    present colours; for a background with alpha they are 0. `target` is premultiplied. The other
    arguments are as in `quantize`.
    """
    is_opaque = target.shape[-1] == 3

    def image_of(colors: Array, background: Array) -> Array:
        _, (image, _) = residual(y._replace(colors=colors), data._replace(background=background))
        if is_opaque:
            return image
        return jnp.concatenate([image[..., :3] * image[..., 3:], image[..., 3:]], -1)

    variables = (y.colors, data.background)
    image, jvp = jax.linearize(image_of, *variables)
    vjp = jax.linear_transpose(jvp, *variables)
    show_background = 1.0 if is_opaque else 0.0
    ones = jnp.ones_like(y.colors), jnp.full_like(data.background, show_background)
    scale = (
        jnp.ones_like(image)
        if weights is None
        else jnp.broadcast_to(weights[..., None], image.shape)
    )
    gradients, curvatures = vjp(scale * (image - target)), vjp(scale * jvp(*ones))

    def rows(of_colors: Array, of_background: Array) -> Array:
        return jnp.concatenate(
            [of_colors.reshape(-1, 3), show_background * of_background[None, :3]]
        )

    return rows(*gradients), rows(*curvatures)


def _lloyd(
    palette: Float[np.ndarray, "colors 3"],
    colors: Float[np.ndarray, "n 3"],
    weight: Float[np.ndarray, " n"],
    rounds: int,
) -> Float[np.ndarray, "colors 3"]:
    """Improve a palette for weighted colours by rounds of k-means; return it, clipped to 0..1.

    In each round, a colour of the palette becomes the weighted mean of the given colours that are
    nearest to it. If the sum of their weights is not above `_LEAST_WEIGHT`, it becomes instead one
    of the given colours with the largest weighted squared distances from the palette.
    """
    for _ in range(rounds):
        labels = nearest(palette, colors)
        total = np.bincount(labels, weight, len(palette))
        sums = [np.bincount(labels, weight * channel, len(palette)) for channel in colors.T]
        mean = np.stack(sums, 1) / np.maximum(total, 1e-300)[:, None]
        palette = np.where(total[:, None] > _LEAST_WEIGHT, mean, palette)
        unused = np.flatnonzero(total <= _LEAST_WEIGHT)
        error = weight * ((colors - palette[labels]) ** 2).sum(1)
        farthest = np.argsort(-error, kind="stable")[: len(unused)]
        palette[unused[: len(farthest)]] = colors[farthest]
    return np.clip(palette, 0.0, 1.0).astype(np.float32)
