"""What subcommands have in common: options that mean the same everywhere, and how a report is said."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

File = Annotated[Path, typer.Argument(show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Log what was inferred.")]
Up = Annotated[
    Optional[str], typer.Option(help="Up axis of the source: +y, +z, ... (inferred if not given).", show_default=False)
]
Unit = Annotated[
    Optional[float], typer.Option(help="Metres per unit of the source (inferred if not given).", show_default=False)
]
SmplModel = Annotated[
    Optional[Path],
    typer.Option(
        "--smpl-model", help="Your SMPL, SMPL+H or SMPL-X model (.npz): the body of .npz motions.", show_default=False
    ),
]

Fps = Annotated[
    Optional[float], typer.Option(help="Frame rate of results (the source's if not given).", show_default=False)
]
MethodName = Annotated[str, typer.Option("--method", help="Method, by name.")]
InPlace = Annotated[bool, typer.Option("--in-place", help="Drop the horizontal path.")]
FootLock = Annotated[bool, typer.Option("--foot-lock/--no-foot-lock", help="Hold what rests on the ground.")]
Steady = Annotated[
    bool, typer.Option("--steady/--no-steady", help="Filter shake that the character's proportions would enlarge.")
]
AnimationOnly = Annotated[bool, typer.Option("--animation-only", help="Write joints and animation, no surface.")]
ContactsFile = Annotated[
    Optional[Path], typer.Option("--contacts", help="Contacts file (see `retarget contacts`).", show_default=False)
]
MapFile = Annotated[
    Optional[Path], typer.Option("--map", help="Joint mapping to use (see `retarget map`).", show_default=False)
]
TargetUp = Annotated[Optional[str], typer.Option(help="Up axis of the character.", show_default=False)]
TargetUnit = Annotated[Optional[float], typer.Option(help="Metres per unit of the character.", show_default=False)]


def listen(verbose: bool) -> None:
    """Warnings, and with `verbose` what was inferred, to standard error."""
    logging.basicConfig(
        format="%(message)s", level=logging.INFO if verbose else logging.WARNING, stream=sys.stderr, force=True
    )


def say(report: dict, as_json: bool) -> None:
    """One JSON object, or the report's own lines when someone is reading."""
    if as_json:
        import json

        print(json.dumps(report, indent=2))
        return
    for line in report["lines"]:
        print(line)
