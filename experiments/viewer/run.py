"""Measure the time from a request to drawn pixels in the viewer, for every bundled scene.

On a busy machine, other work lengthens wall-clock times. So the processor time of an answer, summed
over all threads of the server, is measured too.
"""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax

import softras2d as sr
from softras2d import scenes
from softras2d.numerics.freed_memory import keep_freed_memory
from softras2d.viewing.frames import frames_of
from softras2d.viewing.scene_file import ReadOptions, SceneFile
from softras2d.viewing.scene_in_memory import SceneInMemory
from softras2d.viewing.serve import ViewerServer
from softras2d.viewing.session import Reply, Session
from softras2d.viewing.subject import Subject

from ..common import machine
from .devtools import Page, open_page

RESULTS = Path(__file__).parent / "results"
HEIGHT, WIDTH = 1216, 1600
"""The canvas, in pixels; its sides are multiples of 32."""

PANS = 12
"""Number of views of each scene, over which the median is taken. It is even."""

CALLS = 7
"""Number of calls for each scene, over which the least processor time is taken."""

VIEWS = 500
"""Number of views in the measurement of memory."""

PAUSE = 0.2
"""Pause, in seconds, before a view and before a render that is timed.

Idle cores take some milliseconds to wake up. A user's view begins on idle cores, so a render that
it is compared with must, too."""

MEMORY_SCENE = "rings"

_FRAME = """new Promise((done) => {
  const stage = document.querySelector(".sr-stage");
  const began = performance.now();
  stage.dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowLeft", bubbles: true}));
  requestAnimationFrame(() => done(performance.now() - began));
})"""

_DRAWN_MS = """document.querySelector(".sr-viewer").dataset.drawnMs"""


class _RecordingSession(Session):
    """A session that stores the last request for a picture."""

    last_picture: Mapping[str, Any] = {}

    def answer(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        if request.get("kind") == "picture":
            self.last_picture = request
        return super().answer(request)


def main() -> None:
    """Write `results/response.json`, and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(scenes.names()))
    parser.add_argument("--views", type=int, default=VIEWS)
    arguments = parser.parse_args()
    # As `softras2d view` does.
    sr.keep_compiled_programs()
    keep_freed_memory()
    rows, memory, result = [], [], {}
    for name in arguments.scenes:
        # A separate viewer for each scene: scenes in one viewer would share plans.
        session = _RecordingSession([_subject(name)])
        with ViewerServer(session) as server, open_page(server.url) as page:
            page.resize(HEIGHT, WIDTH)
            page.wait_for_picture()
            # Hides the panel, so that the canvas fills the page.
            page.press("h")
            rows.append({"scene": name} | _measure(page, session))
            print(rows[-1], flush=True)
            if name == MEMORY_SCENE:
                memory = _memory(page, arguments.views)
        # Write after each scene, so that results remain if the run is interrupted.
        result = write(rows, memory)
    print(table(result))


def write(rows: list[dict[str, Any]], memory: list[float]) -> dict[str, Any]:
    """Write `results/response.json`, and return its content."""
    result = {
        "machine": machine.record(["softras2d", "jax", "jaxlib", "starlette", "uvicorn"]),
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


def _measure(page: Page, session: _RecordingSession) -> dict[str, Any]:
    """Time, in ms, from request to drawn pixels, of `render` alone, and of a frame that pans."""
    page.press("ArrowRight")
    _wait_until_compiled(session)
    answers, renders = _answers_and_renders(page, session)
    # Store the measured view, because the frames below pan further.
    request = session.last_picture
    frames = [page.evaluate(_FRAME) for _ in range(PANS)]
    page.wait_for_picture()
    render = _render_of(session, request)
    sizes: list[int] = []
    view = request["view"]
    return {
        "answer_ms": round(statistics.median(answers), 1),
        "least_answer_ms": round(min(answers), 1),
        "render_ms": round(statistics.median(renders), 1),
        "least_render_ms": round(min(renders), 1),
        "answer_processor_ms": _processor_ms(lambda: sizes.append(_answer_bytes(session, request))),
        "render_processor_ms": _processor_ms(render),
        "frame_ms": round(statistics.median(frames), 1),
        "message_mb": round(sizes[-1] / 1e6, 2),
        "canvas": [view["width"], view["height"]],
    }


def _answers_and_renders(page: Page, session: _RecordingSession) -> tuple[list[float], list[float]]:
    """Times, in ms, of views that pan to and fro, and of a render of each after it.

    The renders run in a thread, as they do in the server: the C library has a separate heap for it.
    """
    answers, renders = [], []
    calls: dict[str, Callable[[], object]] = {}
    with ThreadPoolExecutor(1) as thread:
        for key in ("ArrowLeft", "ArrowRight") * (PANS // 2):
            time.sleep(PAUSE)
            answers.append(_pan(page, key))
            if key not in calls:
                calls[key] = _render_of(session, session.last_picture)
                thread.submit(calls[key]).result()
            time.sleep(PAUSE)
            began = time.perf_counter()
            thread.submit(calls[key]).result()
            renders.append(1e3 * (time.perf_counter() - began))
    return answers, renders


def _render_of(session: _RecordingSession, request: Mapping[str, Any]) -> Callable[[], object]:
    """A function that renders the view of a request by `sr.render`, with a plan for it alone."""
    view = request["view"]
    scene = session.subjects[request["subject"]].scene_at(view["zoom"])
    plan = sr.plan(
        scene,
        height=view["height"],
        width=view["width"],
        origin=(view["x"], view["y"]),
        on_overflow="nan",
    )
    return lambda: jax.block_until_ready(sr.render(scene, plan))


def _wait_until_compiled(session: Session) -> None:
    """Wait until no plan is compiled in the background."""
    while session.is_compiling():
        time.sleep(0.1)


def _answer_bytes(session: Session, request: Mapping[str, Any]) -> int:
    """Answer a request as the server does; returns the length of its messages."""
    (reply,) = session.answer(request)
    return sum(len(frame) for frame in frames_of(reply))


def _pan(page: Page, key: str) -> float:
    page.press(key)
    return float(page.evaluate(_DRAWN_MS))


def _processor_ms(call: Callable[[], object]) -> float:
    """The least processor time of `CALLS` calls in a thread, in ms, after a call that compiles."""
    times = []
    with ThreadPoolExecutor(1) as thread:
        thread.submit(call).result()
        for _ in range(CALLS):
            began = time.process_time()
            thread.submit(call).result()
            times.append(1e3 * (time.process_time() - began))
    return round(min(times), 1)


def _memory(page: Page, views: int) -> list[float]:
    """Resident memory of the process, in MiB, after each fifth of the views."""
    resident_mib = []
    for view in range(views):
        page.press(("ArrowLeft", "i", "ArrowUp", "ArrowRight", "o", "ArrowDown")[view % 6])
        if (view + 1) % max(views // 5, 1) == 0:
            resident_mib.append(round(_resident(), 1))
    return resident_mib


def _resident() -> float:
    """Resident memory of this process, in MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def table(result: dict[str, Any]) -> str:
    """The rows as a Markdown table."""
    columns = {
        "request to pixels, ms": "answer_ms",
        "`sr.render`, ms": "render_ms",
        "least of both, ms": ("least_answer_ms", "least_render_ms"),
        "processor time, answer, ms": "answer_processor_ms",
        "processor time, `sr.render`, ms": "render_processor_ms",
        "key to frame, ms": "frame_ms",
        "message, MB": "message_mb",
    }
    lines = ["| scene | " + " | ".join(columns) + " |", "|---|" + "---:|" * len(columns)]
    for row in result["rows"]:
        cells = [_cell(row, key) for key in columns.values()]
        lines.append(f"| {row['scene']} | " + " | ".join(cells) + " |")
    memory = ", ".join(f"{mib:.0f}" for mib in result["memory_mib"])
    return "\n".join([*lines, "", f"Memory: {memory} MiB"])


def _cell(row: dict[str, Any], key: str | tuple[str, str]) -> str:
    """One or two numbers of a row; megabytes have one decimal."""
    keys = (key,) if isinstance(key, str) else key
    return ", ".join(f"{row[k]:.1f}" if k.endswith("_mb") else f"{row[k]:.0f}" for k in keys)


if __name__ == "__main__":
    main()
