"""Triangles that are hard to draw, and comparisons of images with the oracle."""

import numpy as np

import softras2d as sr

from ..oracles.coverage import Canvas

SIZES = {1: (75, 100), 2: (45, 53), 3: (31, 37), 4: (21, 29), 8: (13, 17), 16: (9, 11)}
"""Height and width for each rate: several tiles a side, the last one cut, and few samples."""

COUNT = 40
"""Number of triangles in each case, so that all cases of a rate share one program."""


def canvas(rate: int, fill_rule: str = "inclusive", origin: tuple[int, int] = (0, 0)) -> Canvas:
    return Canvas(*SIZES[rate], rate, fill_rule, origin)


def cases(canvas: Canvas) -> dict[str, np.ndarray]:
    """Named corners `[COUNT, 3, 2]`, float32, all inside the band."""
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
    """Vertices on corners and centres of pixels; centres are samples at odd rates."""
    return rng.integers(-1, 2 * np.array([canvas.width, canvas.height]) + 2, (COUNT, 3, 2)) / 2


def sample_points(rng: np.random.Generator, canvas: Canvas, *shape: int) -> np.ndarray:
    """Positions of samples, exact where the rate is a power of two."""
    size = np.array([canvas.width, canvas.height]) * canvas.rate
    return (2 * rng.integers(0, size, (*shape, 2)) + 1) / (2 * canvas.rate)


def on_samples(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Every vertex on a sample."""
    return sample_points(rng, canvas, COUNT, 3)


def grazing(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Long edges through a sample or one grid unit beside it, the hardest to decide exactly."""
    grid = 2.0**-canvas.exponent
    low, high = canvas.band()
    sample = np.rint(sample_points(rng, canvas, COUNT, 1) / grid) * grid
    # A step that fits between the sample and the nearer border of the band, times whole numbers.
    reach = np.minimum(sample - low, high - sample)
    times = rng.integers(1, 60, (COUNT, 2, 1))
    step = np.floor(rng.uniform(-1, 1, (COUNT, 1, 2)) * reach / grid / times.max(axis=1)[:, None])
    ends = sample + np.array([[[1], [-1]]]) * times * step * grid
    ends[::2, 0] += rng.integers(-1, 2, (COUNT // 2, 2)) * grid
    third = np.rint(rng.uniform(low, high, (COUNT, 1, 2)) / grid) * grid
    return np.concatenate([ends, third], axis=1)


def degenerate(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Zero area: points, segments with repeated or collinear corners, on samples and beside."""
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
    """Across the canvas, thinner than a sample step, in any direction."""
    size = np.array([canvas.width, canvas.height])
    ends = rng.uniform(-0.2, 1.2, (COUNT, 2, 2)) * size
    ends[: COUNT // 4, 1] = ends[: COUNT // 4, 0] + rng.uniform(-1, 1, (COUNT // 4, 2)) * [50, 0.01]
    thickness = np.geomspace(1e-6, 1, COUNT)[:, None]
    return np.concatenate(
        [ends, ends[:, :1] + rng.normal(size=(COUNT, 1, 2)) * thickness[:, None]], 1
    )


def beside(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """Off the canvas on all sides, or touching its border from outside."""
    size = np.array([canvas.width, canvas.height])
    corners = rng.uniform(0, 0.5, (COUNT, 3, 2)) * size.max()
    side = rng.integers(-1, 2, (COUNT, 1, 2))
    side[(side == 0).all(axis=-1)] = 1
    placed = np.where(side < 0, -corners, np.where(side > 0, size + corners, corners))
    touching = rng.random((COUNT, 3, 1)) < 0.3
    return np.where(touching, np.where(side < 0, 0, np.where(side > 0, size, placed)), placed)


def in_band(rng: np.random.Generator, canvas: Canvas) -> np.ndarray:
    """As large as the exact tests allow, corners of the band included."""
    low, high = canvas.band()
    corners = rng.uniform(low, high, (COUNT, 3, 2))
    extreme = np.stack([low, high])[rng.integers(0, 2, (COUNT, 3, 2)), [0, 1]]
    return np.where(rng.random((COUNT, 3, 2)) < 0.5, extreme, corners)


def parked(canvas: Canvas, count: int) -> np.ndarray:
    """Triangles inside the band that cover no sample."""
    low, _ = canvas.band()
    return np.broadcast_to(low + np.array([[0, 0], [0.25, 0], [0, 0.25]]), (count, 3, 2))


def vast(canvas: Canvas, count: int) -> list[np.ndarray]:
    """Four scenes of the largest triangles in the band, what a plan can be asked for at most."""
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
    """Multiples of 1/256, float32 `[count, corners, channels]`: sums of samples are exact."""
    rng = np.random.default_rng(seed)
    return (rng.integers(0, 257, (count, corners, channels)) / 256).astype(np.float32)


def draw_scene(scene: sr.Scene, plan: sr.Plan) -> np.ndarray:
    """The image on the host; an overflow fails."""
    image, overflow = sr.render_checked(scene, plan)
    assert not bool(overflow), "overflow"
    return np.asarray(image)


def assert_same_counts(image: np.ndarray, expected: np.ndarray, samples: int) -> None:
    """Every pixel mixes the same samples: exact for colours that are multiples of 1/256.

    Equal bit for bit where the mean is exact, that is unless the rate is 3.
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
