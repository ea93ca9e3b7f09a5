"""Compare palettes quantised during a fit with palettes quantised after it.

python -m experiments.fit_steering.run [--data ../shared/data/kodak] [--steps 1000] [--side 128]
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

import softras2d as sr
from softras2d import pictures
from softras2d.fitting.resample import shrink

from ..common import machine, report

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "optimistix", "optax", "numpy")
SEED = 0
COLORS = 8
COLUMNS = ("free", "after_mean", "after_best", "during", "gain", "gain_over_best")
PHOTOS = ("kodim05", "kodim13", "kodim20", "kodim23")

FITS: dict[str, dict[str, Any]] = {
    "300 layers": {"triangles": 300},
    "flat mesh of 1,000": {"triangles": 1000, "family": "mesh", "shading": "flat"},
}

Image = Float[np.ndarray, "height width 3"]


def read_target(path: Path, side: int) -> Image:
    """Read a picture, and shrink it to `side` pixels along its longer side."""
    image = sr.read_image(path)[..., :3]
    height, width = image.shape[:2]
    scale = side / max(height, width)
    return shrink(image, round(height * scale), round(width * scale))


def quantized_after(result: sr.FitResult, target: Image) -> tuple[float, float]:
    """PSNR, in dB, of a finished fit whose colours are then quantised: mean, and best of ten runs.

    Each triangle, and the background, gets the mean colour of the target at its visible samples,
    which has the least squared error. K-means reduces these colours to a palette, from ten
    random starts; the weight of a colour is its number of samples.
    """
    size: dict[str, Any] = {"height": result.height, "width": result.width}
    visible = sr.rasterize(result.scene, sr.plan(result.scene, **size, coverage=sr.Hard(16)))
    triangle = np.asarray(visible.triangle).reshape(target.shape[0] * target.shape[1], -1)
    count = result.scene.triangles.shape[0]
    # The background, index -1, comes last.
    triangle_of_sample = np.where(triangle < 0, count, triangle).ravel()
    samples = np.repeat(target.reshape(-1, 3), triangle.shape[1], axis=0)
    weight = np.bincount(triangle_of_sample, minlength=count + 1).astype(np.float64)
    sums = [np.bincount(triangle_of_sample, channel, count + 1) for channel in samples.T]
    mean = np.stack(sums, 1) / np.maximum(weight, 1)[:, None]
    scores = []
    for seed in range(10):
        palette, labels = weighted_kmeans(mean, weight, COLORS, seed)
        image = palette[labels][triangle_of_sample].reshape(*triangle.shape, 3).mean(1)
        error = np.mean((image - target.reshape(-1, 3)) ** 2)
        scores.append(-10 * np.log10(error))
    return float(np.mean(scores)), float(max(scores))


def weighted_kmeans(
    colors: Float[np.ndarray, "n 3"], weight: Float[np.ndarray, " n"], count: int, seed: int
) -> tuple[Float[np.ndarray, "{count} 3"], Int[np.ndarray, " n"]]:
    """Reduce colours by 50 rounds of k-means; return the palette, and its index for each colour."""
    rng = np.random.default_rng(seed)
    palette = colors[rng.choice(len(colors), count, replace=False, p=weight / weight.sum())]
    for _ in range(50):
        labels = ((colors[:, None] - palette) ** 2).sum(-1).argmin(1)
        total = np.bincount(labels, weight, count)
        sums = np.stack([np.bincount(labels, weight * channel, count) for channel in colors.T], 1)
        palette = np.where(total[:, None] > 0, sums / np.maximum(total, 1e-9)[:, None], palette)
    return palette, ((colors[:, None] - palette) ** 2).sum(-1).argmin(1)


def compare(name: str, target: Image, fit: str, steps: int) -> dict[str, Any]:
    """Fit one picture with free colours and with a palette; return a row of the README's table.

    `time_ratio`: seconds of the fit with a palette divided by seconds of the fit with free colours.
    """
    settings: dict[str, Any] = FITS[fit] | {"steps": steps, "seed": SEED}
    free = sr.fit(target, **settings)
    during = sr.fit(target, palette=COLORS, **settings)
    after_mean, after_best = quantized_after(free, target)
    row = {
        "fit": fit,
        "picture": name,
        "free": free.psnr,
        "after_mean": after_mean,
        "after_best": after_best,
        "during": during.psnr,
        "gain": during.psnr - after_mean,
        "gain_over_best": during.psnr - after_best,
        "time_ratio": during.history[-1].seconds / free.history[-1].seconds,
    }
    print({key: round(x, 2) if isinstance(x, float) else x for key, x in row.items()}, flush=True)
    return row


def row_texts(row: dict[str, Any]) -> list[str]:
    """Format a row of the README's table."""
    scores = [f"{row[key]:.2f}" for key in COLUMNS]
    return [row["fit"], row["picture"], *scores]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=Path, default=HERE.parents[2] / "shared/data/kodak")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--fits", nargs="*", default=list(FITS))
    arguments = parser.parse_args()
    start_seconds = time.perf_counter()
    paths = {"valley": Path(pictures.path("valley"))}
    paths |= {name: arguments.data / f"{name}.png" for name in PHOTOS}
    rows = [
        compare(name, read_target(path, arguments.side), fit, arguments.steps)
        for fit in arguments.fits
        for name, path in paths.items()
        if path.is_file()
    ]
    run = {
        "machine": machine.record(PACKAGES),
        "precision": "float32",
        "side": arguments.side,
        "steps": arguments.steps,
        "rows": rows,
    }
    (HERE / "results").mkdir(exist_ok=True)
    report.write_json(HERE / "results/palette.json", run)
    minutes = (time.perf_counter() - start_seconds) / 60
    header = [
        "fit", "picture", "free colours, dB", "palette after, dB", "after, best of 10, dB",
        "palette during, dB",
    ]  # fmt: skip
    header += ["gain, dB", "gain over best of 10, dB"]
    texts = {
        "palette": report.table(header, [row_texts(row) for row in rows]),
        "machine": f"{machine.describe(run, seed=f'seed {SEED}')}; {minutes:.0f} minutes.",
    }
    print(json.dumps([row["gain"] for row in rows]))
    report.fill_or_print(HERE / "README.md", texts)


if __name__ == "__main__":
    main()
