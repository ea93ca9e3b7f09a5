"""Triangles that are hard to draw exactly, and comparisons of images with the oracle."""

import numpy as np

import softras2d as sr

from ..oracles.coverage import Canvas

SIZES = {1: (75, 100), 2: (45, 53), 3: (31, 37), 4: (21, 29), 8: (13, 17), 16: (9, 11)}
"""Height and width of the canvas, in pixels, for each number of samples per pixel side.

Each canvas has several tiles a side, the last of which reaches beyond it, and few samples in all.
"""

COUNT = 40
"""Number of triangles in each case, so that all cases of a rate share one program."""


def canvas(rate: int, fill_rule: str = "inclusive", origin: tuple[int, int] = (0, 0)) -> Canvas:
    return Canvas(*SIZES[rate], rate, fill_rule, origin)


def cases(canvas: Canvas) -> dict[str, np.ndarray]:
    """Corners `[COUNT, 3, 2]` of each case by name, in float32 and within `Canvas.band`."""
    makers = (uniform, small, halves, on_samples, grazing, degenerate, slivers, beside, in_band)
    low, high = canvas.band()
    by_name = {}
    for seed, maker in enumerate(makers):
        corners = maker(np.random.default_rng(seed), canvas)
        assert corners.shape == (COUNT, 3, 2), maker.__name__
        by_name[maker.__name__] = np.clip(corners, low, high).astype(np.float32)
    return by_name


def uniform(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Triangles anywhere on the canvas and a little around it."""
    return rng.uniform(-0.1, 1.1, (COUNT, 3, 2)) * [canvas.width, canvas.height]


def small(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Triangles from three pixels down to less than a sample."""
    centres = rng.uniform(0, 1, (COUNT, 1, 2)) * [canvas.width, canvas.height]
    radius = np.geomspace(1 / (8 * canvas.rate), 3, COUNT)[:, None, None]
    return centres + rng.normal(size=(COUNT, 3, 2)) * radius


def halves(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Vertices at multiples of half a pixel; pixel centres are samples at odd rates."""
    return rng.integers(-1, 2 * np.array([canvas.width, canvas.height]) + 2, (COUNT, 3, 2)) / 2


def sample_points(rng: np.random.Generator, canvas: Canvas, *shape: int) -> np.ndarray:
    """Random positions of samples `[*shape, 2]`, exact where the rate is a power of two."""
    size = np.array([canvas.width, canvas.height]) * canvas.rate
    return (2 * rng.integers(0, size, (*shape, 2)) + 1) / (2 * canvas.rate)


def on_samples(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Every vertex on a sample."""
    return sample_points(rng, canvas, COUNT, 3)


def grazing(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Long edges through a sample, or one grid unit beside it: the hardest to decide exactly."""
    grid = 2.0**-canvas.exponent
    low, high = canvas.band()
    sample = np.rint(sample_points(rng, canvas, COUNT, 1) / grid) * grid
    # Both ends lie an integer number of equal steps from the sample, and within the band.
    reach = np.minimum(sample - low, high - sample)
    times = rng.integers(1, 60, (COUNT, 2, 1))
    step = np.floor(rng.uniform(-1, 1, (COUNT, 1, 2)) * reach / grid / times.max(axis=1)[:, None])
    ends = sample + np.array([[[1], [-1]]]) * times * step * grid
    ends[::2, 0] += rng.integers(-1, 2, (COUNT // 2, 2)) * grid
    third = np.rint(rng.uniform(low, high, (COUNT, 1, 2)) / grid) * grid
    return np.concatenate([ends, third], axis=1)


def degenerate(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Triangles without area, on samples and beside them.

    They are points, and segments with repeated or collinear corners.
    """
    start = sample_points(rng, canvas, COUNT)
    direction = rng.integers(-3, 4, (COUNT, 2))
    direction[::4, rng.integers(2)] = 0
    step = direction / canvas.rate
    shift = np.where(np.arange(COUNT) % 5 == 4, 2.0**-canvas.exponent, 0.0)[:, None]
    shift = shift * rng.integers(0, 2, (COUNT, 2))
    times = rng.integers(-6, 7, (COUNT, 3, 1))
    times[:8] = 0
    times[8:16, 2] = times[8:16, 1]
    return (start + shift)[:, None] + times * step[:, None]


def slivers(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Long triangles across the canvas, from a millionth of a pixel to about a pixel thick."""
    size = np.array([canvas.width, canvas.height])
    ends = rng.uniform(-0.2, 1.2, (COUNT, 2, 2)) * size
    ends[: COUNT // 4, 1] = ends[: COUNT // 4, 0] + rng.uniform(-1, 1, (COUNT // 4, 2)) * [50, 0.01]
    thickness = np.geomspace(1e-6, 1, COUNT)[:, None]
    return np.concatenate(
        [ends, ends[:, :1] + rng.normal(size=(COUNT, 1, 2)) * thickness[:, None]], 1
    )


def beside(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Triangles off the canvas on all sides, some of which touch its border from outside."""
    size = np.array([canvas.width, canvas.height])
    corners = rng.uniform(0, 0.5, (COUNT, 3, 2)) * size.max()
    side = rng.integers(-1, 2, (COUNT, 1, 2))
    side[(side == 0).all(axis=-1)] = 1
    outside = np.where(side < 0, -corners, np.where(side > 0, size + corners, corners))
    touching = rng.random((COUNT, 3, 1)) < 0.3
    return np.where(touching, np.where(side < 0, 0, np.where(side > 0, size, outside)), outside)


def in_band(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Triangles over the whole band, some with corners on its border."""
    low, high = canvas.band()
    corners = rng.uniform(low, high, (COUNT, 3, 2))
    extreme = np.stack([low, high])[rng.integers(0, 2, (COUNT, 3, 2)), [0, 1]]
    return np.where(rng.random((COUNT, 3, 2)) < 0.5, extreme, corners)


def parked(canvas: Canvas, count: int) -> np.ndarray:
    """Triangles `[count, 3, 2]` off the canvas, inside the band, that cover no sample."""
    low, _ = canvas.band()
    return np.broadcast_to(low + np.array([[0, 0], [0.25, 0], [0, 0.25]]), (count, 3, 2))


def vast(canvas: Canvas, count: int) -> list[np.ndarray]:
    """Four scenes of `count` equal triangles that fill half of the band.

    No scene of `count` triangles in the band needs capacities that are much greater.
    """
    low, high = canvas.band()
    middle = (low + high) / 2
    (left, top), (right, bottom), (x, y) = low, high, middle
    shapes = [
        [(left, bottom), (right, bottom), (x, top)],
        [(left, top), (right, top), (x, bottom)],
        [(left, top), (left, bottom), (right, y)],
        [(right, top), (right, bottom), (left, y)],
    ]
    return [np.tile(np.array(shape, np.float32), (count, 1, 1)) for shape in shapes]


def colors_of(count: int, channels: int = 3, corners: int = 1, seed: int = 0) -> np.ndarray:
    """Random colours `[count, corners, channels]` in multiples of 1/256, so that sums are exact."""
    rng = np.random.default_rng(seed)
    return (rng.integers(0, 257, (count, corners, channels)) / 256).astype(np.float32)


def draw_scene(scene: sr.Scene, plan: sr.Plan) -> np.ndarray:
    """The image as a NumPy array; a scene that exceeds the plan fails an assertion."""
    image, overflow = sr.render_checked(scene, plan)
    assert not bool(overflow), "overflow"
    return np.asarray(image)


def assert_same_counts(image: np.ndarray, expected: np.ndarray, samples: int) -> None:
    """Assert that every pixel is the mean of the same samples, for colours in multiples of 1/256.

    Images must be equal bit for bit, except at 9 samples per pixel, where a mean is rounded.
    """
    assert image.shape == expected.shape
    assert image.dtype == np.float32
    wanted = expected.astype(np.float32)
    if samples == 9:
        assert np.abs(image - wanted).max(initial=0) < 2e-7
        image, wanted = (
            np.rint(value.astype(np.float64) * samples * 256) for value in (image, wanted)
        )
    differing = np.argwhere((image != wanted).any(axis=-1))
    if len(differing):
        row, column = differing[0]
        raise AssertionError(
            f"{len(differing)} of {image.shape[0] * image.shape[1]} pixels differ; the first, row "
            f"{row}, column {column}, is {image[row, column]} and should be {wanted[row, column]}."
        )
