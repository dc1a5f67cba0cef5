"""The subcommands for files by the dozen: from one format into another, folders onto folders."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from retarget.cli_options import (
    AnimationOnly,
    ContactsFile,
    Engine,
    File,
    FootLock,
    Fps,
    InPlace,
    Json,
    MapFile,
    MethodName,
    SmplModel,
    Steady,
    TargetUnit,
    TargetUp,
    Unit,
    Up,
    Verbose,
    listen,
    say,
)  # fmt: skip


def convert(
    file: File,
    output: Annotated[
        Path,
        typer.Argument(
            help="The file to write; {clip} in its name stands for the clip: a file each.", show_default=False
        ),
    ],
    clip: Annotated[
        Optional[str], typer.Option(help="Name of the clip (every clip if not given).", show_default=False)
    ] = None,
    fps: Annotated[
        Optional[float], typer.Option(help="Frame rate to write (the file's if not given).", show_default=False)
    ] = None,
    smpl_model: SmplModel = None,
    up: Up = None,
    unit: Unit = None,
    as_json: Json = False,
) -> None:
    """Write a file in another format: `retarget convert dance.fbx dance.glb`."""
    listen(False)
    from retarget.commands_convert import Conversion, convert_file

    say(convert_file(Conversion(file, output, clip, fps, up, unit, smpl_model)), as_json)


def batch(
    motions: Annotated[Path, typer.Argument(help="Folder of motions, mesh sequences and captures too (or one).", show_default=False)],
    characters: Annotated[Path, typer.Argument(help="Folder of characters (or one file).", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.", show_default=False)],
    jobs: Annotated[
        Optional[int],
        typer.Option(help="Processes at work (one a core if not given).", min=1, max=256, show_default=False),
    ] = None,
    timeout: Annotated[float, typer.Option(help="Seconds that one clip may take; 0 for no limit.", min=0)] = 1800.0,
    suffix: Annotated[
        Optional[str],
        typer.Option(help="Format of the results, as in `run` (.glb, or what --for wants).", show_default=False),
    ] = None,
    engine: Engine = None,
    pages: Annotated[
        bool, typer.Option("--report", help="Also write the page of `retarget report` beside each result.")
    ] = False,
    fps: Fps = None,
    method: MethodName = "auto",
    in_place: InPlace = False,
    foot_lock: FootLock = True,
    steady: Steady = True,
    animation_only: AnimationOnly = False,
    contacts_file: ContactsFile = None,
    map_file: MapFile = None,
    smpl_model: SmplModel = None,
    up: Up = None,
    unit: Unit = None,
    target_up: TargetUp = None,
    target_unit: TargetUnit = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Put every motion of a folder onto every character of another; start it again to resume:
    `retarget batch captures/ characters/ -o results/`."""
    listen(verbose)
    from retarget.commands_batch import make_batch, report_batch

    order = make_batch(
        motions, characters, output, jobs=jobs, timeout=timeout, suffix=suffix, engine=engine, pages=pages, fps=fps, method=method,
        in_place=in_place, foot_lock=foot_lock, steady=steady, animation_only=animation_only, contacts=contacts_file,
        map_file=map_file, smpl_model=smpl_model, up=up, unit=unit, target_up=target_up, target_unit=target_unit,
    )  # fmt: skip
    report = report_batch(order, progress=sys.stderr.isatty() and not as_json)
    say(report, as_json)
    if report["failed"]:
        raise typer.Exit(1)
