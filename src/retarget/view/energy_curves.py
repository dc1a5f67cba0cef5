"""Energies of a descent over its iterations, one line a term, as one picture (as Basset 2019, figure 5b)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from retarget.io.whole_file import written_whole

TERMS = {"shape": "#0072b2", "volume": "#009e73", "repulsion": "#d55e00", "attraction": "#cc79a7", "total": "#3b3b3b"}
"""Terms of equation 1 and their colours, apart for every kind of colour vision (Okabe and Ito 2008)."""
WIDTH, HEIGHT, DPI = 7.0, 4.0, 110
"""Inches, and pixels an inch."""


def save_energies(path: Path, energies: Mapping[str, Sequence[float]], title: str) -> None:
    """Write the picture: energies on a logarithmic axis, since they are many times apart; terms without any are left out."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    axis = figure.subplots()
    axis.set_title(title, fontsize=10, loc="left", weight="bold")
    for term, colour in TERMS.items():
        values = energies.get(term, ())
        if any(value > 0 for value in values):
            axis.plot(range(len(values)), values, color=colour, label=term, linewidth=1.2)
    axis.set_yscale("log")
    axis.set_xlabel("iteration")
    axis.set_ylabel("energy (square metres; volume cubic metres squared)")
    axis.legend(frameon=False, fontsize=8)
    with written_whole(path) as file:
        figure.savefig(file, format="png", dpi=DPI)
