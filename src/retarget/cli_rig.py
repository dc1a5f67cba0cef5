"""The subcommand that rigs: `rig`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from retarget.cli_options import Json, Verbose, listen, say


def rig(
    mesh: Annotated[
        Path, typer.Argument(help="A mesh or a cloud of points, in any pose.", show_default=False)
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The rigged character to write.", show_default=False)],
    template: Annotated[
        Optional[Path],
        typer.Option(help="Rigged character whose rig it gets (the embedded human if not given).", show_default=False),
    ] = None,
    landmarks: Annotated[
        Optional[str],
        typer.Option(
            help="Places on the mesh: head=VERTEX,left_hand=X:Y:Z,... (2 to 7 help); joints of the template are names too.",
            show_default=False,
        ),
    ] = None,
    surface_map: Annotated[
        Optional[Path],
        typer.Option(
            help="Map onto the template: its vertex for each of the mesh's (.txt, .csv, .npz), or C with its bases (.npz).",
            show_default=False,
        ),
    ] = None,
    unit: Annotated[
        Optional[float], typer.Option(help="Metres per unit of the mesh (inferred if not given).", show_default=False)
    ] = None,
    as_json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Give a bare mesh a skeleton, weights and a rest pose: `retarget rig statue.obj -o statue.glb`."""
    listen(verbose)
    from retarget.commands_rig import RigOrder, rig_file

    order = RigOrder(mesh, output, template, landmarks, surface_map, unit)
    say(rig_file(order, progress=sys.stderr.isatty() and not as_json), as_json)
