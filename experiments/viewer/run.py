"""How fast the page answers: from a request to drawn pixels, for every bundled scene."""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

import softras2d as sr
from softras2d import scenes
from softras2d.viewing.scene_file import ReadOptions, SceneFile
from softras2d.viewing.scene_in_memory import SceneInMemory
from softras2d.viewing.serve import ViewerServer
from softras2d.viewing.session import Session
from softras2d.viewing.subject import Subject
from tests.cases.pages import running_browser, wait_for_picture

from ..common import machine

RESULTS = Path(__file__).parent / "results"
HEIGHT, WIDTH = 1216, 1600
"""The canvas, in pixels; its sides are multiples of 32."""

PANS, VIEWS = 11, 500
"""Views of each scene of which the median is taken; views after which memory is measured."""

_FRAME = """() => new Promise((done) => {
  const stage = document.querySelector(".sr-stage");
  const began = performance.now();
  stage.dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowLeft", bubbles: true}));
  requestAnimationFrame(() => done(performance.now() - began));
})"""


def main() -> None:
    """Write `results/response.json`, and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(scenes.names()))
    parser.add_argument("--views", type=int, default=VIEWS)
    arguments = parser.parse_args()
    sr.keep_compiled_programs()
    subjects = [_subject(name) for name in arguments.scenes]
    rows = []
    with ViewerServer(Session(subjects)) as server, running_browser() as browser:
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT + 28})
        page.goto(server.url)
        page.keyboard.press("h")
        wait_for_picture(page)
        for number, name in enumerate(arguments.scenes):
            page.get_by_label("File").select_option(str(number)) if len(subjects) > 1 else None
            wait_for_picture(page)
            rows.append({"scene": name} | _measure(page, subjects[number]))
            print(rows[-1], flush=True)
        memory = _memory(page, arguments.views)
    result = {
        "machine": machine.record(["softras2d", "jax", "jaxlib", "starlette", "uvicorn"]),
        "canvas": [WIDTH, HEIGHT],
        "rows": rows,
        "memory_mib": memory,
    }
    (RESULTS / "response.json").write_text(json.dumps(result, indent=1) + "\n")
    print(table(result))


def _subject(name: str) -> Subject:
    if scenes.is_scripted(name):
        return SceneInMemory(name, scenes.read(name), scenes.SIZE, scenes.SIZE)
    dialect = "course" if name == "hairlines" else "svg"
    return SceneFile(scenes.path(name), ReadOptions(dialect))


def _measure(page: Any, subject: Subject) -> dict[str, float]:
    """Milliseconds from request to drawn pixels, of `render` alone, and of a frame that pans."""
    page.locator(".sr-stage").focus()
    page.keyboard.press("ArrowRight")
    wait_for_picture(page)
    answers = [_pan(page, key) for key in ("ArrowLeft", "ArrowRight") * (PANS // 2 + 1)]
    frames = [page.evaluate(_FRAME) for _ in range(PANS)]
    wait_for_picture(page)
    zoom = 0.96 * HEIGHT / subject.size()[0]
    scene = subject.scene_at(zoom)
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, on_overflow="nan")
    alone = _times(lambda: sr.render(scene, plan), 5)
    return {
        "answer_ms": round(statistics.median(answers), 1),
        "render_ms": round(statistics.median(alone), 1),
        "frame_ms": round(statistics.median(frames), 1),
    }


def _pan(page: Any, key: str) -> float:
    page.keyboard.press(key)
    wait_for_picture(page)
    return float(page.locator(".sr-viewer").get_attribute("data-drawn-ms"))


def _times(call: Callable[[], Any], count: int) -> list[float]:
    """Milliseconds of each call, after one that compiles."""
    jax.block_until_ready(call())
    times = []
    for _ in range(count):
        began = time.perf_counter()
        jax.block_until_ready(call())
        times.append(1e3 * (time.perf_counter() - began))
    return times


def _memory(page: Any, views: int) -> list[float]:
    """MiB that the process holds, after a fifth of the views and every fifth from there."""
    page.get_by_label("File").select_option("0")
    wait_for_picture(page)
    page.locator(".sr-stage").focus()
    held = []
    for view in range(views):
        page.keyboard.press(("ArrowLeft", "i", "ArrowUp", "ArrowRight", "o", "ArrowDown")[view % 6])
        wait_for_picture(page)
        if (view + 1) % max(views // 5, 1) == 0:
            held.append(round(_resident(), 1))
    return held


def _resident() -> float:
    """MiB of memory that this process holds."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def table(result: dict[str, Any]) -> str:
    """The rows as a Markdown table."""
    lines = ["| scene | request to pixels, ms | `sr.render` alone, ms | frame, ms |"]
    lines += ["|---|---:|---:|---:|"]
    for row in result["rows"]:
        numbers = [row[name] for name in ("answer_ms", "render_ms", "frame_ms")]
        lines.append(f"| {row['scene']} | " + " | ".join(f"{n:.0f}" for n in numbers) + " |")
    held = ", ".join(f"{mib:.0f}" for mib in result["memory_mib"])
    return "\n".join([*lines, "", f"Memory: {held} MiB"])


if __name__ == "__main__":
    main()
