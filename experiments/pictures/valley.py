"""A lake among mountains on a hazy evening."""

import numpy as np

from .noise import fractal, look_up, mix, ramp, ridged, smooth

HEIGHT, WIDTH = 256, 384
FOCAL_PX, HORIZON_PX, EYE_KM = 400.0, 148.0, 0.07
SUN = np.array([0.30, 0.178])
"""Direction of the sun as tangents of its angles right of the middle and above the horizon."""
LIGHT = np.array([0.80, 0.40, 0.12])
"""Direction of light (right, up, away); further to the side than `SUN`, to show more relief."""
NEAREST, FARTHEST, CELL_KM = 2.0, 13.0, 0.009
HALF_KM = 6.3
"""Width of the land to either side, in km."""


def valley(samples: int) -> np.ndarray:
    """Radiance, in linear light, with `samples` x `samples` samples per pixel."""
    rng = np.random.default_rng(7)
    rows = (np.arange(HEIGHT * samples) + 0.5) / samples
    columns = (np.arange(WIDTH * samples) + 0.5) / samples
    up, right = (HORIZON_PX - rows) / FOCAL_PX, (columns - WIDTH / 2) / FOCAL_PX
    clouds = fractal(rows / 26, columns / 110, rng, 6, 0.55)
    fan = _Fan(right, rng)

    land, distance = fan.seen(up, EYE_KM)
    image = mix(_sky(up, right, clouds), land[..., :3], land[..., 3:])

    # The reflection is the view upwards from as far below the surface. Ripples shift its rows.
    down = np.maximum(-up, 1e-4)
    mirrored, _ = fan.seen(down, -EYE_KM)
    mirrored = mix(_sky(down, right, clouds[::-1]), mirrored[..., :3], mirrored[..., 3:])
    away = EYE_KM / down
    water = (up[:, None] < 0) & (away[:, None] < distance)
    image = np.where(water[..., None], _lake(mirrored, away, down, right, samples, rng), image)
    image = _bank(image, rows, columns, rng)
    # Compress bright parts, as photographic film does, so that the sun stays within range.
    return 1 - np.exp(-1.22 * np.clip(image, 0, None))


def _sky(up: np.ndarray, right: np.ndarray, clouds: np.ndarray) -> np.ndarray:
    """Blue above and gold below, the sun with its glow, and thin clouds."""
    height = ramp(up, -0.02, 0.38)[:, None, None]
    glow = _glow(up, right)
    sky = mix(np.array([0.86, 0.60, 0.40]), np.array([0.13, 0.27, 0.52]), height**0.75)
    sky = sky + glow[..., None] * np.array([0.85, 0.50, 0.20])
    band = ramp(up, 0.02, 0.16) * ramp(up, 0.42, 0.24)
    share = ramp(clouds, -0.25, 1.9)[..., None] * band[:, None, None]
    lit = np.array([0.95, 0.70, 0.58]) + glow[..., None] * np.array([0.9, 0.55, 0.25])
    sky = mix(sky, lit, 0.85 * share)
    from_sun = np.hypot(right[None, :] - SUN[0], up[:, None] - SUN[1])
    disc = ramp(from_sun, 0.0245, 0.0205)[..., None]
    return sky + disc * np.array([4.0, 3.2, 1.9])


def _glow(up: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Light scattered forward by haze, 1 at the sun."""
    squared = (right[None, :] - SUN[0]) ** 2 + 1.3 * (up[:, None] - SUN[1]) ** 2
    return 0.55 * np.exp(-squared / 0.006) + 0.45 * np.exp(-np.sqrt(squared) / 0.16)


class _Fan:
    """The land along one line of sight for each column: heights and colours at many distances."""

    def __init__(self, right: np.ndarray, rng: np.random.Generator):
        self.distance = np.geomspace(NEAREST, FARTHEST, 800)
        height, color = _land(rng)
        rows = (self.distance[:, None] - NEAREST) / CELL_KM + 0 * right
        columns = (self.distance[:, None] * right + HALF_KM) / CELL_KM
        self.height = look_up(height, rows, columns)
        color = look_up(color, rows, columns)
        # Haze fills the valley: along a line of sight, it is thinner towards higher ground.
        thickness = 0.115 * (self.distance[:, None] - 1.5) * np.exp(-0.75 * self.height.clip(0))
        clear = np.exp(-thickness)[..., None]
        glow = _glow(np.full(1, 0.10), right)[..., None]
        haze = mix(np.array([0.36, 0.43, 0.56]), np.array([1.15, 0.80, 0.52]), glow)
        self.color = mix(haze, color, clear)

    def seen(self, up: np.ndarray, eye: float) -> tuple[np.ndarray, np.ndarray]:
        """Colours with alpha `[rows, columns, 4]`, and distances, from an eye `eye` km above water.

        Land is hit at the first distance at which it reaches as high as the line of sight.
        """
        slope = np.where(self.height > 0, (self.height - eye) / self.distance[:, None], -9.0)
        reached = np.maximum.accumulate(slope)
        count, columns = slope.shape
        hit = np.stack([np.searchsorted(reached[:, j], up) for j in range(columns)], 1)
        land, hit = hit < count, np.clip(hit, 1, count - 1)
        across = np.arange(columns)[None, :]
        before, after = slope[hit - 1, across], slope[hit, across]
        share = np.clip((up[:, None] - before) / np.maximum(after - before, 1e-9), 0, 1)
        color = mix(self.color[hit - 1, across], self.color[hit, across], share[..., None])
        distance = np.where(land, self.distance[hit], np.inf)
        return np.concatenate([color, land[..., None]], -1), distance


def _land(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Heights in km and colours in evening light, on a grid over (away, right)."""
    away = np.arange(NEAREST, FARTHEST + 0.1, CELL_KM)
    right = np.arange(-HALF_KM, HALF_KM, CELL_KM)
    z, x = away[:, None], right[None, :]
    crests = ridged(away / 2.1, right / 1.9, rng, 7, 0.52)
    rolling = fractal(away / 1.3, right / 1.3, rng, 4, 0.45)

    side = np.abs(x - 0.25 * np.sin(0.9 * z) + 0.1) + 0.10 * rolling
    shore = 1.15 - 0.95 * ramp(z, 3.0, 5.6)
    height = 0.75 * ramp(side, shore, shore + 2.4) - 0.03 + 0.05 * ramp(side, shore, shore + 0.2)
    for peak_x, peak_z, top, radius in (
        (-0.55, 9.6, 2.35, 3.0),
        (-3.1, 8.0, 1.75, 2.4),
        (2.1, 11.2, 1.70, 2.8),
        (-2.9, 4.9, 0.85, 1.7),
        (3.0, 6.2, 1.0, 2.0),
    ):
        far = np.hypot(x - peak_x, z - peak_z) / radius
        height = height + top * np.clip(1 - far, 0, None) ** 1.25
    # Relief grows with height, so that the shore is gentle and the summits are rough.
    height = height * (0.45 + 0.95 * crests) + 0.05 * rolling * ramp(height, 0.0, 0.4)

    grain = fractal(away / 0.10, right / 0.10, rng, 3, 0.7)
    down, right_on = np.gradient(height, CELL_KM)
    steep = np.hypot(down, right_on)
    wooded = ramp(0.62 + 0.10 * rolling - height, 0.0, 0.22) * ramp(steep, 1.5, 0.9)
    wooded = wooded * ramp(height, 0.003, 0.02)
    crowns = np.abs(smooth(away / 0.022, right / 0.022, rng))
    height = height + 0.022 * wooded * crowns

    slope_z, slope_x = np.gradient(height, CELL_KM)
    light = LIGHT / np.linalg.norm(LIGHT)
    facing = (light[1] - slope_x * light[0] - slope_z * light[2]) / np.sqrt(
        1 + slope_x**2 + slope_z**2
    )
    sun = np.clip(facing, 0, None) * (1 - _shadow(height))
    snowy = ramp(height + 0.16 * grain + 0.1 * rolling, 1.05, 1.45) * ramp(steep, 2.0, 1.0)
    rock = np.array([0.20, 0.17, 0.15]) * (1 + 0.16 * grain[..., None])
    meadow = np.array([0.15, 0.16, 0.045]) * (1 + 0.15 * grain[..., None])
    albedo = mix(rock, meadow, (ramp(steep, 0.9, 0.45) * ramp(height, 1.1, 0.7))[..., None])
    woods = np.array([0.035, 0.055, 0.025]) * (0.4 + 0.9 * crowns[..., None])
    albedo = mix(albedo, woods, wooded[..., None])
    albedo = mix(albedo, np.array([0.80, 0.82, 0.86]), snowy[..., None])
    beam, ambient = np.array([2.7, 1.75, 0.95]), np.array([0.27, 0.36, 0.52])
    return height, albedo * (sun[..., None] * beam + ambient)


def _shadow(height: np.ndarray) -> np.ndarray:
    """1 where higher ground to the right hides the sun, with a soft edge."""
    above, rise = np.full_like(height, -1.0), LIGHT[1] / LIGHT[0]
    for step in range(2, 150, 4):
        ground = height[:, step:] - rise * step * CELL_KM
        above[:, :-step] = np.maximum(above[:, :-step], ground - height[:, :-step])
    return ramp(above, 0.0, 0.06)


def _lake(
    mirrored: np.ndarray,
    away: np.ndarray,
    down: np.ndarray,
    right: np.ndarray,
    samples: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """The mirrored view on rippled water, which reflects more at grazing angles."""
    depth = np.log(np.clip(away, 0.05, 30))
    ripples = fractal(depth * 34, right * 22, rng, 3, 0.6)
    breeze = ramp(fractal(depth * 4, right * 3.2, rng, 3), 0.1, 1.3)
    strength = samples * (0.55 + 2.6 * breeze) * (0.35 + 9 * down[:, None])
    rows = np.arange(len(away))[:, None] + strength * ripples + 2.5 * samples * breeze
    reflected = look_up(mirrored, rows, np.arange(len(right))[None, :] + 0.0)
    share = 0.30 + 0.62 * np.exp(-5.5 * down)[:, None]
    deep = np.array([0.020, 0.050, 0.060])
    return mix(deep, reflected, share[..., None]) + 0.02 * breeze[..., None]


def _bank(
    image: np.ndarray, rows: np.ndarray, columns: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """The near bank, dark against the water, with grass and fir trees at both sides."""
    edge = 244 - 34 * ramp(columns, 150, -10) - 22 * ramp(columns, 285, 400)
    edge = edge + 2.2 * fractal(np.zeros(1), columns / 21, rng, 4)[0]
    blades = np.abs(smooth(np.zeros(1), columns / 1.1, rng)[0]) * 2.6
    ground = rows[:, None] - (edge - blades)[None, :]
    tufts = fractal(rows / 5, columns / 2.2, rng, 4, 0.65)
    lit = 1 + 0.45 * tufts + 1.6 * np.exp(-np.clip(ground, 0, None) / 3.5)
    grass = np.array([0.040, 0.046, 0.016]) * np.clip(lit, 0.15, None)[..., None]
    image = mix(image, grass, ramp(ground, -0.1, 0.1)[..., None])
    trees = [(14, 150), (44, 112), (72, 74), (-6, 120), (98, 44), (330, 52), (352, 84), (378, 118)]
    for x, tall in sorted(trees, key=lambda tree: tree[1]):
        root = np.interp(x, columns, edge) + 3 + 0.05 * tall
        image = _fir(image, rows, columns, x, root, tall, rng)
    return image


def _fir(
    image: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    x: float,
    root: float,
    tall: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """A fir of `tall` pixels: tiers of drooping branches, ragged, with light on the right."""
    near = np.abs(columns - x) < 0.26 * tall
    high = (rows > root - tall) & (rows < root)
    fall, aside = rows[high] - (root - tall), columns[near] - x
    tiers = 9 + tall / 9
    ragged = fractal(fall / 2.6, aside / 4.5, rng, 3, 0.7)
    out = np.abs(aside)[None, :] / tall
    # Branches hang, so the same tier is lower further from the trunk.
    tier = (fall[:, None] / tall) ** 0.85 * tiers - 9 * out + 0.45 * (aside > 0)
    reach = 0.012 + 0.17 * (fall / tall)[:, None] ** 0.9 * (0.55 + 0.45 * (tier % 1.0))
    inside = ramp(reach + 0.011 * ragged - out, 0.0, 0.004)
    trunk = np.abs(aside)[None, :] < 0.004 * tall * (0.4 + fall / tall)[:, None]
    inside = np.maximum(inside, trunk)[..., None]
    lit = ramp(aside[None, :] / tall + 0.03 * ragged, -0.02, 0.13) * (0.3 + 0.7 * (tier % 1.0))
    color = np.array([0.012, 0.019, 0.013]) * (1 + 0.3 * ragged[..., None])
    color = color + lit[..., None] * np.array([0.085, 0.062, 0.020])
    image = image.copy()
    place = np.ix_(high, near)
    image[place] = mix(image[place], np.clip(color, 0.002, None), inside)
    return image
