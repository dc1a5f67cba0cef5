"""The subcommands that show: `view` in the browser, `report` as one page."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from retarget.cli_options import Json, SmplModel, Unit, Up, listen, say

Clip = Annotated[
    Optional[str],
    typer.Option(help="The result's clip (the last one of the source's name if not given).", show_default=False),
]
SourceClip = Annotated[
    Optional[str],
    typer.Option(help="The source's clip (the one that the result names, or of its name).", show_default=False),
]
Start = Annotated[
    Optional[float],
    typer.Option(help="First second of the source to compare with (as the result says, or 0).", show_default=False),
]
End = Annotated[Optional[float], typer.Option(help="Last second of it.", show_default=False)]
MapFile = Annotated[
    Optional[Path], typer.Option("--map", help="Joint mapping to use (see `retarget map`).", show_default=False)
]


def view(
    result: Annotated[Path, typer.Argument(help="The animated character, or motion, to look at.", show_default=False)],
    sources: Annotated[
        Optional[list[Path]], typer.Argument(help="Motions or characters to see beside it.", show_default=False)
    ] = None,
    clip: Clip = None,
    source_clip: SourceClip = None,
    start: Start = None,
    end: End = None,
    map_file: MapFile = None,
    smpl_model: SmplModel = None,
    up: Up = None,
    unit: Unit = None,
    port: Annotated[
        Optional[int],
        typer.Option(help="Port on this machine (any free one if not given).", min=1, max=65535, show_default=False),
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Look at a result in the browser, beside its source: `retarget view knight_dance.glb dance.bvh`."""
    listen(False)
    from retarget.commands_view import Showing, view_files

    showing = Showing(result, tuple(sources or ()), clip, source_clip, start, end, map_file, up, unit, smpl_model)
    view_files(showing, port, browser, progress=sys.stderr.isatty())


def report(
    result: Annotated[Path, typer.Argument(help="The animated character to report on.", show_default=False)],
    source: Annotated[
        Optional[Path], typer.Argument(help="The motion that it was made from.", show_default=False)
    ] = None,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", help="The .html to write.", show_default=False)],
    clip: Clip = None,
    source_clip: SourceClip = None,
    start: Start = None,
    end: End = None,
    map_file: MapFile = None,
    smpl_model: SmplModel = None,
    up: Up = None,
    unit: Unit = None,
    as_json: Json = False,
) -> None:
    """One HTML page with the moving result, figures, curves and findings: `retarget report knight_dance.glb dance.bvh -o r.html`."""
    listen(False)
    from retarget.commands_view import Showing, write_report

    sources = () if source is None else (source,)
    showing = Showing(result, sources, clip, source_clip, start, end, map_file, up, unit, smpl_model)
    say(write_report(showing, output, progress=sys.stderr.isatty() and not as_json), as_json)
