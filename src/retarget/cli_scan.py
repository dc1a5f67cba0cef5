"""The subcommands for captures: the skeleton in one, and poses out while clouds come in."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from retarget.cli_options import FootLock, Json, MethodName, TargetUnit, TargetUp, Unit, Up, Verbose, listen, say


def skeleton(
    capture: Annotated[Path, typer.Argument(help="Point clouds: a folder or an archive.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write.", show_default=False)],
    start: Annotated[Optional[float], typer.Option(help="First second to take.", show_default=False)] = None,
    end: Annotated[Optional[float], typer.Option(help="Last second to take.", show_default=False)] = None,
    fps: Annotated[Optional[float], typer.Option(help="Frames a second of the capture.", show_default=False)] = None,
    body: Annotated[bool, typer.Option("--body", help="With the fitted body: its surface, and its fingers at rest.")] = False,
    foot_lock: FootLock = True,
    causal: Annotated[bool, typer.Option("--causal", help="Frame by frame without a look ahead, as `stream` does.")] = False,
    up: Up = None,
    unit: Unit = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Write the motion of the body in a capture: `retarget skeleton capture/ -o capture.bvh`."""
    listen(verbose)
    from retarget.commands_scan import SkeletonOrder, track_skeleton

    order = SkeletonOrder(capture, output, start, end, fps, up, unit, body, foot_lock, causal)
    say(track_skeleton(order, progress=sys.stderr.isatty() and not as_json), as_json)


def stream(
    target: Annotated[Path, typer.Option("--target", help="The character.", show_default=False)],
    source: Annotated[
        str, typer.Option("--in", help="Clouds: - for standard input, a file, or 127.0.0.1:PORT to listen there.")
    ] = "-",
    output: Annotated[
        str, typer.Option("--output", "-o", help="Poses, a line of JSON each: a file, or - for standard output.")
    ] = "-",
    fps: Annotated[float, typer.Option(help="Frames a second of the stream.")] = 30.0,
    method: MethodName = "auto",
    up: Annotated[str, typer.Option(help="Up axis of the stream.")] = "+y",
    unit: Annotated[float, typer.Option(help="Metres per unit of the stream.")] = 1.0,
    target_up: TargetUp = None,
    target_unit: TargetUnit = None,
    view: Annotated[bool, typer.Option("--view", help="Show the character live in a browser on this machine.")] = False,
    port: Annotated[Optional[int], typer.Option(help="Port of --view (any free one if not given).", show_default=False)] = None,
) -> None:
    """Clouds in, poses out, frame by frame: `scanner | retarget stream --target hero.glb > poses.jsonl`.

    A frame of the stream is a little-endian uint32 with the number of points, then three float32 a point.
    """
    listen(False)
    from retarget.commands_scan import StreamOrder, stream_poses

    order = StreamOrder(source, target, output, fps, method, up, unit, target_up, target_unit, view, port)
    for line in stream_poses(order)["lines"]:
        print(line, file=sys.stderr)
