"""The command line: one subcommand per public function.

Nothing heavy is imported before a subcommand runs, so `retarget --help` answers at once.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from retarget import cli_capture, cli_files, cli_rig, cli_scan, cli_train
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
    PageBesideReport,
    SmplModel,
    Steady,
    TargetUnit,
    TargetUp,
    Unit,
    Up,
    Verbose,
)  # fmt: skip
from retarget.cli_options import listen as _listen
from retarget.cli_options import say as _say
from retarget.cli_view import report, view
from retarget.evaluate.formulas import FORMULAS, REPORTED

app = typer.Typer(
    name="retarget",
    help="Any motion onto any body.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

PRESET_NAMES = "average woman man thin heavy very_heavy muscular tall short elderly child toddler"
"""As in `body.human.PRESETS`, which would load numpy for a help text."""


INTERRUPTED = 130
"""Exit code of a command that Ctrl-C ended."""


def main() -> None:
    """Entry point: user mistakes become one line on standard error and exit code 2."""
    from retarget.errors import RetargetError

    try:
        app()
    except RetargetError as error:
        print(f"retarget: {error}", file=sys.stderr)
        sys.exit(2)
    except MemoryError:
        print("retarget: this needs more memory than there is", file=sys.stderr)
        sys.exit(2)
    except SystemExit as leaving:
        if leaving.code == INTERRUPTED:  # typer makes it of Ctrl-C, without a word
            print("retarget: interrupted", file=sys.stderr)
        raise
    except BrokenPipeError:  # the reader of our output went away; not an error of the user's
        sys.stderr.close()
        sys.exit(0)


def _version(wanted: bool) -> bool:
    if wanted:
        from retarget import __version__

        print(__version__)
        raise typer.Exit()
    return wanted


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command(cls=PageBesideReport)
def run(
    inputs: Annotated[
        list[Path], typer.Argument(help="Motions (files or folders), and last the character.", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File, or folder when several results come out.", show_default=False)
    ],
    clip: Annotated[
        Optional[str], typer.Option(help="Name of the clip, for files with several.", show_default=False)
    ] = None,
    all_clips: Annotated[bool, typer.Option("--all-clips", help="Every clip of every motion file.")] = False,
    start: Annotated[Optional[float], typer.Option(help="First second to take.", show_default=False)] = None,
    end: Annotated[Optional[float], typer.Option(help="Last second to take.", show_default=False)] = None,
    fps: Fps = None,
    method: MethodName = "auto",
    in_place: InPlace = False,
    foot_lock: FootLock = True,
    steady: Steady = True,
    repair_contacts: Annotated[
        bool,
        typer.Option(
            "--repair-contacts/--no-repair-contacts",
            help="Keep contacts and take out penetration (method auto); without, rotations are copied.",
        ),
    ] = True,
    one_rig: Annotated[
        Optional[bool],
        typer.Option(
            "--one-rig/--no-one-rig",
            help="Give bodies on one rig equal rotations, or make limbs point the same way; the first for captures.",
            show_default=False,
        ),
    ] = None,
    animation_only: AnimationOnly = False,
    surface: Annotated[
        bool,
        typer.Option(
            "--surface",
            help="Write the moving surface itself, exact to the vertex and without a skeleton: .glb (morph targets), .npz, .usd, .abc or a folder; of a character that is a cloud its points: .glb, .npz or a folder.",
        ),
    ] = False,
    contacts_file: ContactsFile = None,
    engine: Engine = None,
    show_report: Annotated[
        bool,
        typer.Option(
            "--report",
            help="Also print what was corrected, where and by how much; --report FILE.html writes the page of `retarget report`.",
        ),
    ] = False,
    page: Annotated[Optional[Path], typer.Option("--report-page", hidden=True)] = None,
    map_file: MapFile = None,
    smpl_model: SmplModel = None,
    up: Up = None,
    unit: Unit = None,
    target_up: TargetUp = None,
    target_unit: TargetUnit = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Put motions on a character: `retarget run dance.bvh knight.glb -o knight_dance.glb`."""
    _listen(verbose)
    from retarget.commands_run import Order, run_order
    from retarget.errors import RetargetError

    if len(inputs) < 2:
        raise RetargetError(f"give at least one motion and, last, the character; received only {inputs[0]}")
    settings = {"in_place": in_place, "foot_lock": foot_lock, "steady": steady}
    if one_rig is not None:
        settings["one_rig"] = one_rig
    order = Order(
        motions=tuple(inputs[:-1]), target=inputs[-1], output=output, clip=clip, all_clips=all_clips, start=start, end=end,
        fps=fps, method=method, settings=settings, repair_contacts=repair_contacts,
        animation_only=animation_only, map_file=map_file, up=up, unit=unit, target_up=target_up, target_unit=target_unit,
        contacts=contacts_file, report=show_report, page=page, engine=engine, smpl_model=smpl_model, surface=surface,
    )  # fmt: skip
    _say(run_order(order, progress=sys.stderr.isatty() and not as_json), as_json)


app.command()(cli_rig.rig)
app.command()(cli_scan.skeleton)
app.command()(cli_scan.stream)
app.command()(cli_files.batch)
app.command()(cli_files.convert)
app.command()(cli_capture.simulate_scan)
app.command()(cli_train.train)


@app.command()
def info(file: File, smpl_model: SmplModel = None, as_json: Json = False) -> None:
    """What a file holds: kind, units, up axis, facing, joints with canonical names and confidence, clips, faults."""
    from retarget.commands import describe

    _say(describe(file, smpl_model), as_json)


@app.command("map")
def map_(
    source: File,
    target: File,
    output: Annotated[Path, typer.Option("--output", "-o", help="The map file to write (TOML).", show_default=False)],
) -> None:
    """Write the joint mapping between two files, to check, edit and reuse with `run --map`."""
    from retarget.commands import write_joint_map

    _say(write_joint_map(source, target, output), False)


@app.command()
def contacts(
    source: File,
    output: Annotated[
        Optional[Path], typer.Option("--output", "-o", help="The contacts file to write (TOML).", show_default=False)
    ] = None,
    clip: Annotated[
        Optional[str], typer.Option(help="Name of the clip (the first if not given).", show_default=False)
    ] = None,
    start: Annotated[Optional[float], typer.Option(help="First second to take.", show_default=False)] = None,
    end: Annotated[Optional[float], typer.Option(help="Last second to take.", show_default=False)] = None,
    map_file: Annotated[
        Optional[Path], typer.Option("--map", help="Joint mapping to use (see `retarget map`).", show_default=False)
    ] = None,
    smpl_model: SmplModel = None,
    up: Up = None,
    unit: Unit = None,
    as_json: Json = False,
) -> None:
    """List which parts of the body touch when, and write them to edit and give to `run --contacts`."""
    _listen(False)
    from retarget.commands_contacts import Search, find_contacts

    _say(find_contacts(Search(source, output, clip, start, end, map_file, up, unit, smpl_model)), as_json)


@app.command()
def repair(
    file: File,
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write.", show_default=False)],
    clip: Annotated[
        Optional[str], typer.Option(help="Name of the clip (every clip if not given).", show_default=False)
    ] = None,
    foot_lock: Annotated[
        bool, typer.Option("--foot-lock/--no-foot-lock", help="Hold what rests on the ground.")
    ] = True,
    map_file: Annotated[
        Optional[Path], typer.Option("--map", help="Joint mapping to use (see `retarget map`).", show_default=False)
    ] = None,
    up: Up = None,
    unit: Unit = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Take self-penetration and foot slide out of an animated character's clips, whoever made them."""
    _listen(verbose)
    from retarget.commands_repair import Repair, repair_file

    order = Repair(file, output, clip, foot_lock, map_file, up, unit)
    _say(repair_file(order, progress=sys.stderr.isatty() and not as_json), as_json)


@app.command()
def body(
    output: Annotated[Path, typer.Option("--output", "-o", help="The .glb to write.", show_default=False)],
    preset: Annotated[
        Optional[str], typer.Option(help=f"A body to start from: {PRESET_NAMES}.", show_default=False)
    ] = None,
    gender: Annotated[Optional[float], typer.Option(help="0 female to 1 male.", show_default=False)] = None,
    age: Annotated[
        Optional[float], typer.Option(help="0 one year, 0.19 twelve, 0.5 twenty-five, 1 ninety.", show_default=False)
    ] = None,
    muscle: Annotated[Optional[float], typer.Option(help="0 to 1.", show_default=False)] = None,
    weight: Annotated[Optional[float], typer.Option(help="0 to 1; up to 2 extrapolates.", show_default=False)] = None,
    height: Annotated[Optional[float], typer.Option(help="Metres.", show_default=False)] = None,
    proportions: Annotated[Optional[float], typer.Option(help="0 to 1.", show_default=False)] = None,
    shape: Annotated[
        Optional[list[str]], typer.Option(help="A finer component, NAME=VALUE; may be repeated.", show_default=False)
    ] = None,
    plain: Annotated[bool, typer.Option("--plain", help="One colour a region instead of a texture.")] = False,
    motion: Annotated[
        Optional[str], typer.Option(help="An embedded motion to perform (see `retarget motions`).", show_default=False)
    ] = None,
) -> None:
    """Write the embedded parametric human: `retarget body --weight 0.9 --height 1.6 --age 0.3 -o child.glb`."""
    from retarget.commands import write_body

    given = dict(gender=gender, age=age, muscle=muscle, weight=weight, height=height, proportions=proportions)
    given = {name: value for name, value in given.items() if value is not None}
    _say(write_body(output, preset, given, shape or [], motion, plain), False)


@app.command()
def motions() -> None:
    """List the embedded motions."""
    from retarget.commands import list_motions

    _say(list_motions(), False)


@app.command()
def picture(
    files: Annotated[list[Path], typer.Argument(help="Animated characters or motions, one a row.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", help="The .png to write.", show_default=False)],
    frames: Annotated[int, typer.Option(help="Pictures a row.", min=1, max=32)] = 8,
    size: Annotated[int, typer.Option(help="Height of a picture in pixels.", min=64, max=2048)] = 512,
    view: Annotated[str, typer.Option(help="three-quarter, front, side, back, or degrees.")] = "three-quarter",
    clip: Annotated[
        Optional[str], typer.Option(help="Name of the clip (the last one if not given).", show_default=False)
    ] = None,
    smpl_model: SmplModel = None,
) -> None:
    """Draw frames side by side, several files as rows."""
    from retarget.commands import draw

    _say(draw(files, output, frames, size, view, clip, smpl_model), False)


@app.command("evaluate", epilog="\n\n".join(f"{key}: {FORMULAS[key]}." for key in REPORTED))
def evaluate_(
    result: Annotated[Path, typer.Argument(help="The animated character, or motion, to judge.", show_default=False)],
    source: Annotated[Path, typer.Option(help="The motion that it was made from.", show_default=False)],
    truth: Annotated[
        Optional[Path],
        typer.Option(help="The true animation of the result's character, where it is known.", show_default=False),
    ] = None,
    output: Annotated[
        Optional[Path], typer.Option("--output", "-o", help="Also draw curves over time (.png).", show_default=False)
    ] = None,
    clip: Annotated[
        Optional[str],
        typer.Option(help="The result's clip (the last one of the source's name if not given).", show_default=False),
    ] = None,
    source_clip: Annotated[
        Optional[str],
        typer.Option(help="The source's clip (the one that the result names, or of its name).", show_default=False),
    ] = None,
    truth_clip: Annotated[
        Optional[str], typer.Option(help="The truth's clip (the last one of the result's name).", show_default=False)
    ] = None,
    start: Annotated[
        Optional[float],
        typer.Option(help="First second of the source to compare with (as the result says, or 0).", show_default=False),
    ] = None,
    end: Annotated[Optional[float], typer.Option(help="Last second of it.", show_default=False)] = None,
    fps: Annotated[
        Optional[float],
        typer.Option(help="Frames a second to judge at (30, or the file's if fewer).", show_default=False),
    ] = None,
    map_file: Annotated[
        Optional[Path], typer.Option("--map", help="Joint mapping to use (see `retarget map`).", show_default=False)
    ] = None,
    smpl_model: SmplModel = None,
    up: Up = None,
    unit: Unit = None,
    as_json: Json = False,
) -> None:
    """Judge a result before accepting it: `retarget evaluate knight_dance.glb --source dance.bvh -o curves.png`."""
    _listen(False)
    from retarget.commands_evaluate import Question, evaluate_files

    question = Question(
        result, source, truth, output, clip, source_clip, truth_clip, start, end, fps, map_file, up, unit, smpl_model
    )
    _say(evaluate_files(question, progress=sys.stderr.isatty() and not as_json), as_json)


app.command()(view)
app.command()(report)


@app.command(epilog="\n\n".join(f"{key}: {sentence}." for key, sentence in FORMULAS.items()))
def bench(
    name: Annotated[str, typer.Argument(help="contact, formats, interaction, rig-transfer, scan, shape-transfer or skeletal")],
    quick: Annotated[bool, typer.Option("--quick", help="An honest subset in about a minute (scan: two).")] = False,
    json_file: Annotated[
        Optional[Path], typer.Option("--json", help="Also write everything to this file.", show_default=False)
    ] = None,
    gate: Annotated[
        bool, typer.Option("--gate", help="Fail (exit code 1) where a figure is worse than the committed baseline.")
    ] = False,
    learned: Annotated[
        bool, typer.Option("--learned", help="interaction: with networks, ours and, where their weights are at hand, the papers'.")
    ] = False,
    pictures: Annotated[
        Optional[Path], typer.Option(help="rig-transfer, scan, shape-transfer: write sheets to this folder.", show_default=False)
    ] = None,
    verbose: Verbose = False,
) -> None:
    """Measure the methods on fixed cases, all in one run."""
    _listen(verbose)
    from retarget.commands_evaluate import run_bench

    report = run_bench(f"{name}-learned" if learned else name, quick, json_file, gate, sys.stderr.isatty(), pictures)
    _say(report, False)
    if report.get("regressions"):
        raise typer.Exit(1)
