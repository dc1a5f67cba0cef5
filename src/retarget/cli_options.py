"""What subcommands have in common: options that mean the same everywhere, and how a report is said."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from typer.core import TyperCommand

PAGES = (".html", ".htm")
"""How names of pages end."""
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
Engine = Annotated[
    Optional[str], typer.Option("--for", help="Conventions of: unreal, unity, blender or godot.", show_default=False)
]
MapFile = Annotated[
    Optional[Path], typer.Option("--map", help="Joint mapping to use (see `retarget map`).", show_default=False)
]
TargetUp = Annotated[Optional[str], typer.Option(help="Up axis of the character.", show_default=False)]
TargetUnit = Annotated[Optional[float], typer.Option(help="Metres per unit of the character.", show_default=False)]


class PageBesideReport(TyperCommand):
    """A command whose switch `--report` may be followed by a page to write: typer knows no options with a value or without.

    `--report FILE.html` and `--report=FILE` are read as the hidden option `--report-page FILE`.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, page_named(args))


def page_named(words: list[str]) -> list[str]:
    """The words of a command line with the page of `--report` under its own option; after `--` nothing is an option."""
    options = words[: words.index("--")] if "--" in words else words
    named = []
    for number, word in enumerate(options):
        page = number + 1 < len(options) and options[number + 1].lower().endswith(PAGES)
        if word == "--report" and page or word.startswith("--report="):
            word = word.replace("--report", "--report-page", 1)
        named.append(word)
    return [*named, *words[len(options) :]]


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
