"""Make the README's picture of fits: `python -m experiments.fit_kodak.picture`."""

from pathlib import Path

import numpy as np

import softras2d as sr

HERE = Path(__file__).parent


def main() -> None:
    """Draw the bundled landscape, 50 and 500 flat layers, and a mesh of 2,000 triangles."""
    target = sr.read_image(sr.pictures.path("valley"))
    fits = [
        sr.fit(target, triangles=50, steps=1500),
        sr.fit(target, triangles=500, steps=2500),
        sr.fit(target, triangles=2000, family="mesh", steps=250),
    ]
    for result in fits:
        print(result.scene.triangles.shape[0], f"{result.psnr:.2f} dB, SSIM {result.ssim:.3f}")
    gap = np.ones((target.shape[0], 8, 3), np.float32)
    row = [part for image in (target, *(fit.image for fit in fits)) for part in (image, gap)]
    sr.write_image(HERE / "results" / "valley.png", np.concatenate(row[:-1], 1))


if __name__ == "__main__":
    main()
