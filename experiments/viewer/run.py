"""How fast the page answers: from a request to drawn pixels, for every bundled scene.

On a busy machine the times of the clock are those of the other work too. So the processor time of
an answer, of all threads of the server, is measured beside them.
"""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax

import softras2d as sr
from softras2d import scenes
from softras2d.viewing.frames import frame_of
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

PANS, RENDERS, VIEWS = 11, 7, 500
"""Views of each scene of which the median is taken; renders of each; views after which memory is
measured."""

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
    rows, memory, result = [], [], {}
    with running_browser() as browser:
        for name in arguments.scenes:
            # A viewer of its own: scenes that share one also share plans.
            session = Session([_subject(name)])
            with ViewerServer(session) as server:
                page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT + 28})
                requests: list[str] = []
                # Playwright takes no bound method of a built-in type.
                note = lambda text, requests=requests: requests.append(text)  # noqa: E731
                page.on("websocket", lambda socket, note=note: socket.on("framesent", note))
                page.goto(server.url)
                page.keyboard.press("h")
                wait_for_picture(page)
                rows.append({"scene": name} | _measure(page, session, requests))
                print(rows[-1], flush=True)
                if name == arguments.scenes[-1]:
                    memory = _memory(page, arguments.views)
                page.close()
            # After each scene, so that a run that is stopped leaves what it has measured.
            result = write(rows, memory)
    print(table(result))


def write(rows: list[dict[str, Any]], memory: list[float]) -> dict[str, Any]:
    """Write `results/response.json`; returns what it holds."""
    result = {
        "machine": machine.record(["softras2d", "jax", "jaxlib", "starlette", "uvicorn"]),
        "canvas": [WIDTH, HEIGHT],
        "rows": rows,
        "memory_mib": memory,
    }
    (RESULTS / "response.json").write_text(json.dumps(result, indent=1) + "\n")
    return result


def _subject(name: str) -> Subject:
    if scenes.is_scripted(name):
        return SceneInMemory(name, scenes.read(name), scenes.SIZE, scenes.SIZE)
    dialect = "course" if name == "hairlines" else "svg"
    return SceneFile(scenes.path(name), ReadOptions(dialect))


def _measure(page: Any, session: Session, requests: list[str]) -> dict[str, Any]:
    """Milliseconds from request to drawn pixels, of `render` alone, and of a frame that pans.

    `requests`: what the page has sent so far; the last picture is the one that is drawn alone.
    """
    page.locator(".sr-stage").focus()
    page.keyboard.press("ArrowRight")
    wait_for_picture(page)
    _wait_until_compiled(session)
    answers = [_pan(page, key) for key in ("ArrowLeft", "ArrowRight") * (PANS // 2 + 1)]
    frames = [page.evaluate(_FRAME) for _ in range(PANS)]
    wait_for_picture(page)
    sent = [json.loads(text) for text in requests]
    request = [message for message in sent if message["kind"] == "picture"][-1]
    view = request["view"]
    scene = session.subjects[request["subject"]].scene_at(view["zoom"])
    plan = sr.plan(
        scene,
        height=view["height"],
        width=view["width"],
        origin=(view["x"], view["y"]),
        on_overflow="nan",
    )
    alone = _times(lambda: jax.block_until_ready(sr.render(scene, plan)), RENDERS)
    sizes: list[int] = []
    answered = _times(lambda: sizes.append(_answer_bytes(session, request)), RENDERS)
    return {
        "answer_ms": round(statistics.median(answers), 1),
        "least_answer_ms": round(min(answers), 1),
        "render_ms": round(statistics.median(alone.wall), 1),
        "least_render_ms": round(min(alone.wall), 1),
        "answer_processor_ms": round(min(answered.processor), 1),
        "render_processor_ms": round(min(alone.processor), 1),
        "frame_ms": round(statistics.median(frames), 1),
        "message_mb": round(sizes[-1] / 1e6, 2),
    }


def _wait_until_compiled(session: Session) -> None:
    """Wait until no plan is compiled in the background."""
    while session.is_compiling():
        time.sleep(0.1)


def _answer_bytes(session: Session, request: dict[str, Any]) -> int:
    """Answer a request as the server does; returns the length of its message."""
    (reply,) = session.answer(request)
    return len(frame_of(reply))


def _pan(page: Any, key: str) -> float:
    page.keyboard.press(key)
    wait_for_picture(page)
    return float(page.locator(".sr-viewer").get_attribute("data-drawn-ms"))


class Times(NamedTuple):
    """Milliseconds of several calls, by the clock and of the processor."""

    wall: list[float]
    processor: list[float]


def _times(call: Callable[[], Any], count: int) -> Times:
    """The times of some calls, after one that compiles."""
    call()
    times = Times([], [])
    for _ in range(count):
        wall, processor = time.perf_counter(), time.process_time()
        call()
        times.wall.append(1e3 * (time.perf_counter() - wall))
        times.processor.append(1e3 * (time.process_time() - processor))
    return times


def _memory(page: Any, views: int) -> list[float]:
    """MiB that the process holds, after a fifth of the views and every fifth from there."""
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
    columns = {
        "request to pixels, ms": "answer_ms",
        "`sr.render`, ms": "render_ms",
        "least of each": ("least_answer_ms", "least_render_ms"),
        "processor, answer, ms": "answer_processor_ms",
        "processor, `sr.render`, ms": "render_processor_ms",
        "frame, ms": "frame_ms",
        "message, MB": "message_mb",
    }
    lines = ["| scene | " + " | ".join(columns) + " |", "|---|" + "---:|" * len(columns)]
    for row in result["rows"]:
        cells = [_cell(row, key) for key in columns.values()]
        lines.append(f"| {row['scene']} | " + " | ".join(cells) + " |")
    held = ", ".join(f"{mib:.0f}" for mib in result["memory_mib"])
    return "\n".join([*lines, "", f"Memory: {held} MiB"])


def _cell(row: dict[str, Any], key: str | tuple[str, str]) -> str:
    """One or two numbers of a row; megabytes with a digit."""
    keys = (key,) if isinstance(key, str) else key
    return ", ".join(f"{row[k]:.1f}" if k.endswith("_mb") else f"{row[k]:.0f}" for k in keys)


if __name__ == "__main__":
    main()
