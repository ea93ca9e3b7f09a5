"""Make the tables of all runs: `python -m experiments.fit_kodak.figure`."""

import json
from pathlib import Path
from typing import Any

from ..common import machine, report

HERE = Path(__file__).parent


def publish(results: Path, readme: Path) -> None:
    """Write the table of each folder of results for which the README has markers."""
    text = readme.read_text()
    for folder in sorted(path for path in results.iterdir() if (path / "run.json").exists()):
        if f"<!-- {folder.name} -->" not in text:
            continue
        rows = report.read_csv(folder / "fits.csv")
        run = json.loads((folder / "run.json").read_text())
        about = machine.describe(run, seed="seed 0")
        told = f"{_table(rows)}\n\n{about}; {run['seconds'] / 60:.0f} minutes."
        report.fill_markers(readme, folder.name, told)


def _table(rows: list[dict[str, Any]]) -> str:
    header = ["picture", "fit", "parameters", "triangles", "PSNR, dB", "SSIM", "seconds", "steps",
              "greedy mesh, dB", "gain over greedy, dB",
              "mesh with flips, dB", "gain over flips, dB"]  # fmt: skip
    lines = [_line(row) for row in rows]
    kinds = dict.fromkeys((row["family"], row["shading"], row["parameters"]) for row in rows)
    for kind in kinds:
        alike = [r for r in rows if (r["family"], r["shading"], r["parameters"]) == kind]
        if len(alike) > 1:
            keys = ("triangles", "psnr", "ssim", "seconds", "steps", "greedy_psnr", "static_psnr")
            mean = {
                key: sum(float(r[key]) for r in alike) / len(alike) if alike[0].get(key) else ""
                for key in keys
            }
            lines.append(_line({**alike[0], **mean, "picture": f"mean of {len(alike)}"}))
    return report.table(header, lines)


def _line(row: dict[str, Any]) -> list[str]:
    fit_psnr = float(row["psnr"])
    # Earlier runs measured only the mesh with flips.
    static = [float(row[key]) if row.get(key) else None for key in ("greedy_psnr", "static_psnr")]
    return [
        row["picture"],
        f"{row['family']}, {row['shading']}",
        f"{int(row['parameters']):,}",
        f"{float(row['triangles']):,.0f}",
        f"{fit_psnr:.2f}",
        f"{float(row['ssim']):.3f}",
        f"{float(row['seconds']):.0f}",
        f"{float(row['steps']):,.0f}",
        *(cell for psnr in static for cell in _against(fit_psnr, psnr)),
    ]


def _against(psnr: float, static: float | None) -> tuple[str, str]:
    """Cells for the PSNR of another method, in dB, and the gain of the fit over it."""
    return ("", "") if static is None else (f"{static:.2f}", f"{psnr - static:+.2f}")


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
