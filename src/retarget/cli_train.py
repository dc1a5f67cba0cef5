"""The subcommand that learns: `train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from retarget.cli_options import Json, listen, say


def train(
    name: Annotated[str, typer.Argument(help="skeleton-regressor, skinning-field, interaction, paper-skr, paper-smrm, paper-skin, paper-meshret, paper-r2et or an ablation of these (any other word lists them)", show_default=False)],
    folder: Annotated[
        Path, typer.Option("--output", "-o", help="Folder of the state, the log and the baked bodies.", show_default=False)
    ],
    data: Annotated[
        Optional[Path],
        typer.Option(help="Folder with motions/ and characters/ (embedded motions alone if not given).", show_default=False),
    ] = None,
    steps: Annotated[
        Optional[int], typer.Option(help="Steps in all (the recipe's if not given).", min=1, show_default=False)
    ] = None,
    weights: Annotated[
        Optional[Path], typer.Option(help="Folder to write the network to (OUTPUT/weights).", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Learn a network of the package again: `retarget train skinning-field -o out/field`. Goes on where it was cut off."""
    listen(True)
    from retarget.commands_train import train_network

    say(train_network(name, folder, data, steps, weights), as_json)
