"""The subcommand that makes captures: `simulate-scan`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from retarget.cli_options import Json, Verbose, listen, say


def simulate_scan(
    motion: Annotated[Path, typer.Argument(help="The motion, in any file that `run` takes.", show_default=False)],
    character: Annotated[
        Path, typer.Argument(help="Who performs it: a character, or the motion's own file.", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The folder to make, or an .npz file.", show_default=False)
    ],
    cameras: Annotated[int, typer.Option(help="Depth cameras around the body; 1 is a half view.", min=1, max=64)] = 4,
    points: Annotated[int, typer.Option(help="Points of a frame, at most.", min=1, max=1_000_000)] = 6890,
    noise: Annotated[float, typer.Option(help="Noise of a depth, millimetres; 0 is none.", min=0.0, max=1000.0)] = 3.0,
    holes: Annotated[float, typer.Option(help="How much is lost to holes, 0 to 1.", min=0.0, max=1.0)] = 0.2,
    outliers: Annotated[float, typer.Option(help="Share of the points at edges that fly.", min=0.0, max=1.0)] = 0.1,
    floor: Annotated[bool, typer.Option("--floor", help="Leave pieces of the floor in.")] = False,
    seed: Annotated[int, typer.Option(help="The same seed gives the same files.", min=0, max=2**63 - 1)] = 0,
    fps: Annotated[
        Optional[float], typer.Option(help="Frame rate of the capture (the motion's if not given).", show_default=False)
    ] = None,
    clip: Annotated[
        Optional[str], typer.Option(help="Name of the clip, for files with several.", show_default=False)
    ] = None,
    form: Annotated[
        Optional[str], typer.Option("--format", help="Of the frames in a folder: ply or pcd.", show_default=False)
    ] = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Capture a performance as depth cameras would: `retarget simulate-scan walk.bvh knight.glb -o capture`."""
    listen(verbose)
    from retarget.commands_capture import CaptureOrder, simulate_scan
    from retarget.geometry.capture import Scanner

    metres = noise / 1000
    scanner = Scanner(
        cameras,
        points,
        noise=metres,
        steps=metres / 3,
        misplaced=metres / 2,
        holes=holes,
        outliers=outliers,
        floor=floor,
    )
    order = CaptureOrder(motion, character, output, scanner, seed, fps, clip, form)
    say(simulate_scan(order, progress=sys.stderr.isatty() and not as_json), as_json)
