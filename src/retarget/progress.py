"""Tell who waits what is being done: one line on standard error, gone when the work is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Tell = Callable[[str, int], None]
"""Called with what is being done now and how many steps were finished since the last call."""


def untold(doing: str, finished: int = 0) -> None:
    """For nobody watching."""


@contextmanager
def progress_line(shown: bool, total: int | None = None) -> Iterator[Tell]:
    """A line with what is being done, a bar over `total` steps (one that only moves where it is None), and the time.

    Silent unless `shown`: whoever calls finds out whether standard error is a terminal.
    """
    if not shown:
        yield untold
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total)
        yield lambda doing, finished=0: bar.update(task, description=escape(doing), advance=finished)
