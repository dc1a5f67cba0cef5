"""What `retarget skeleton` and `retarget stream` do: the motion in a capture alone, and poses out while clouds come in."""

from __future__ import annotations

import json
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from retarget.casting import Hints, cast
from retarget.character import Character, Motion, Provenance
from retarget.errors import FileError, RetargetError
from retarget.io import check_output, load, save
from retarget.io.cloud_stream import CloudStream
from retarget.live import LivePose, LiveRetargeter
from retarget.motion.filter import cut_clouds
from retarget.performing import ScanPerformer, cast_scan
from retarget.progress import progress_line
from retarget.retargeting import prepare

BODY = 22
"""Joints of the embedded human without its fingers, which are not followed."""


@dataclass(frozen=True)
class SkeletonOrder:
    """What `retarget skeleton` was asked for."""

    capture: Path
    output: Path
    start: float | None = None
    end: float | None = None
    fps: float | None = None
    up: str | None = None
    unit: float | None = None
    body: bool = False
    """Write the fitted body with its surface, too."""
    foot_lock: bool = True
    causal: bool = False


def track_skeleton(order: SkeletonOrder, progress: bool = False) -> dict[str, Any]:
    """Follow a capture's body and write its skeleton's motion. Raises `RetargetError` for what cannot be done."""
    check_output(order.output)
    asset = load(order.capture)
    if asset.clouds is None:
        raise FileError(order.capture, f"holds a {asset.kind}; a capture is needed: a folder or archive of point clouds")
    capture = asset.clouds if order.fps is None else replace(asset.clouds, fps=order.fps)
    with progress_line(progress) as tell:
        try:
            seen = cast_scan(
                cut_clouds(capture, order.start, order.end), Hints(None, order.up, order.unit), asset.convention,
                causal=order.causal, tell=lambda doing, _=0: tell(doing),
            )  # fmt: skip
        except RetargetError as error:
            raise FileError(order.capture, str(error)) from None
        character, motion = standing(seen, order.foot_lock)
        made_from = Provenance.whole(order.capture, replace(motion, name=capture.name))
        if not order.body:
            character, motion = bare_skeleton(character, motion)
        save(order.output, character, [replace(motion, made_from=made_from)])
    height = f"{seen.actor.height:.2f} m tall"
    lines = [f"{order.output}: {len(motion)} frames at {motion.fps:g} fps, a body {height}"]
    return {
        "frames": len(motion), "fps": motion.fps, "height_m": round(seen.actor.height, 4), "shown": int(seen.shown.sum()),
        "notes": list(seen.notes), "lines": [*lines, *(f"  {note}" for note in seen.notes)],
    }  # fmt: skip


def standing(seen: ScanPerformer, foot_lock: bool) -> tuple[Character, Motion]:
    """Who was followed and what he does, feet held where they rest."""
    if not foot_lock:
        return seen.actor.character, seen.motion
    held = prepare(seen.actor, seen.actor, "copy-rotations", limits=False)(seen.motion)
    return seen.actor.character, held.motion


def bare_skeleton(character: Character, motion: Motion) -> tuple[Character, Motion]:
    """The joints that are followed, without surface and fingers."""
    whole = character.skeleton
    skeleton = replace(
        whole, names=whole.names[:BODY], parents=whole.parents[:BODY], offsets=whole.offsets[:BODY],
        rest_rotations=whole.rest_rotations[:BODY], end_offsets=None,
    )  # fmt: skip
    return Character(skeleton, name=character.name), replace(motion, skeleton=skeleton, rotations=motion.rotations[:, :BODY])


@dataclass(frozen=True)
class StreamOrder:
    """What `retarget stream` was asked for."""

    source: str
    """'-' for standard input, a file, or HOST:PORT to listen on, of this machine only."""
    target: Path
    output: str = "-"
    fps: float = 30.0
    method: str = "auto"
    up: str = "+y"
    unit: float = 1.0
    target_up: str | None = None
    target_unit: float | None = None
    view: bool = False
    port: int | None = None


def stream_poses(order: StreamOrder) -> dict[str, Any]:
    """Poses of a character, a line of JSON each, while clouds come in; ends with the stream. Raises `RetargetError` for what
    cannot begin, and for a stream that is none."""
    target = cast(order.target, Hints(None, order.target_up, order.target_unit))
    with ExitStack() as open_things:
        output = open_things.enter_context(_output(order.output))
        live = LiveRetargeter(target, order.method, order.fps, order.up, order.unit)
        viewer = None
        if order.view:
            from retarget.view.live_stream import StreamViewer

            viewer = StreamViewer(target, order.port)
            open_things.callback(viewer.close)
            print(f"live at {viewer.address}", file=sys.stderr, flush=True)
        stream = CloudStream(open_things.enter_context(_input(order.source)))
        _write(output, live.header())
        told = Latencies()
        for cloud in stream:
            started = time.perf_counter()
            pose = live.step(cloud)
            told.add(time.perf_counter() - started, pose)
            _write(output, live.line(pose) | {"ms": round(told.last * 1e3, 2)})
            if viewer is not None:
                viewer.show(pose)
    return told.report(stream)


class Latencies:
    """How long frames took: a histogram, so that memory does not grow with the stream."""

    STEP, MOST = 5e-4, 4000

    def __init__(self) -> None:
        self.counts = np.zeros(self.MOST + 1, dtype=np.int64)
        self.last, self.first = 0.0, None
        self.states: dict[str, int] = {}

    def add(self, seconds: float, pose: LivePose) -> None:
        """One frame more. The first that shows somebody, after which all is prepared, is told apart."""
        self.last = seconds
        self.states[pose.status] = self.states.get(pose.status, 0) + 1
        if self.first is None and pose.motion is not None:
            self.first = seconds
        else:
            self.counts[min(int(seconds / self.STEP), self.MOST)] += 1

    def at(self, share: float) -> float:
        """Milliseconds within which so large a share of the frames was done."""
        if not self.counts.sum():
            return 0.0
        return float((np.searchsorted(np.cumsum(self.counts), share * self.counts.sum()) + 1) * self.STEP * 1e3)

    def report(self, stream: CloudStream) -> dict[str, Any]:
        """The figures, and lines of them for people."""
        states = ", ".join(f"{count} {state}" for state, count in sorted(self.states.items()))
        lines = [f"{stream.frames} frames ({states or 'none'}); {self.at(0.5):.1f} ms a frame, p99 {self.at(0.99):.1f} ms"]
        if self.first is not None:
            lines[0] += f"; the first that showed somebody took {self.first * 1e3:.0f} ms"
        if stream.cut_short:
            lines.append("the stream ended within a frame; all whole frames are written")
        return {
            "frames": stream.frames, "states": self.states, "latency_ms_median": self.at(0.5), "latency_ms_p99": self.at(0.99),
            "cut_short": stream.cut_short, "lines": lines,
        }  # fmt: skip


@contextmanager
def _output(name: str) -> Iterator[TextIO]:
    if name == "-":
        yield sys.stdout
        return
    path = Path(name)
    try:
        with open(path, "w") as file:
            yield file
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None


@contextmanager
def _input(source: str) -> Iterator[Any]:
    if source == "-":
        yield sys.stdin.buffer
        return
    host, colon, port = source.rpartition(":")
    if colon and port.isdigit() and not Path(source).exists():
        if host not in ("", "localhost", "127.0.0.1"):
            raise RetargetError(f"--in listens on this machine only: 127.0.0.1:{port}, received {source!r}")
        with socket.create_server(("127.0.0.1", int(port))) as server:
            print(f"listening on 127.0.0.1:{server.getsockname()[1]}", file=sys.stderr, flush=True)
            connection, _ = server.accept()
            with connection, connection.makefile("rb") as file:
                yield file
        return
    try:
        with open(source, "rb") as file:
            yield file
    except OSError as error:
        raise FileError(Path(source), f"cannot be read: {error.strerror or error}") from None


def _write(output: TextIO, line: dict[str, Any]) -> None:
    output.write(json.dumps(line, separators=(",", ":")) + "\n")
    output.flush()
