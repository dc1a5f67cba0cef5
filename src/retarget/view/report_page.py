"""One self-contained page on a result: the playing scene, figures, findings, curves, and what was inferred.

The page loads nothing, from disk or network: a content security policy forbids it, and the script (`player.js`) and the
style (`page.css`) stand inside. Equal input gives equal bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path

from retarget.evaluate.problems import Problem
from retarget.evaluate.report import Report
from retarget.io.whole_file import written_whole
from retarget.view.page_curves import curve_panels
from retarget.view.page_data import scene_json
from retarget.view.stage import StageBody

POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'"


@dataclass(frozen=True)
class Sheet:
    """What a report's page says in words."""

    title: str
    subtitle: str
    columns: tuple[str, ...]
    """Heads of the table of figures, after the one of the rows: who was measured."""
    rows: tuple[tuple[str, str, tuple[str, ...], str], ...]
    """Group (empty: as above), words, a value a column, unit."""
    problems: tuple[Problem, ...] = ()
    corrected: tuple[str, ...] = ()
    """What was changed beyond copying joint angles, a sentence each."""
    inferred: tuple[str, ...] = ()
    """Units, axes, matching, and why."""
    notes: tuple[str, ...] = ()
    """Warnings."""


def joint_table(bodies: Sequence[StageBody]) -> list[tuple[str, list[tuple[str, float] | None], list[int]]]:
    """The mapping of joints through the canonical ones: (canonical name, (joint, confidence) a body or None, joint
    numbers a body, -1 for none)."""
    known = dict.fromkeys(name for body in bodies for name in body.take.actor.humanoid.joints)
    rows = []
    for name in known:
        found = [body.take.actor.humanoid.joints.get(name, -1) for body in bodies]
        told = [
            (body.take.actor.skeleton.names[joint], body.take.actor.humanoid.confidence[name]) if joint >= 0 else None
            for body, joint in zip(bodies, found)
        ]
        rows.append((name, told, found))
    return rows


def save_report_page(
    path: Path, sheet: Sheet, bodies: Sequence[StageBody], report: Report, before: Report | None = None
) -> int:
    """Write the page; returns its size in bytes. Bodies are of one clock, the result first."""
    with page_about_to_stand(path, sheet, bodies, report, before) as size:
        return size


@contextmanager
def page_about_to_stand(
    path: Path, sheet: Sheet, bodies: Sequence[StageBody], report: Report, before: Report | None = None
) -> Iterator[int]:
    """Yields the size in bytes with the page on the disk, but not in its place before the block ends, and not at all where
    the block fails: for a page that shall stand only beside what the block writes."""
    text = report_page(sheet, bodies, report, before).encode()
    with written_whole(path) as file:
        file.write(text)
        file.flush()
        yield len(text)


def report_page(sheet: Sheet, bodies: Sequence[StageBody], report: Report, before: Report | None = None) -> str:
    """The page's HTML."""
    here = files("retarget.view")
    parts = {
        "policy": POLICY,
        "title": escape(sheet.title),
        "subtitle": escape(sheet.subtitle),
        "style": here.joinpath("page.css").read_text(encoding="utf-8"),
        "bodies": "".join(_body_switches(bodies)),
        "figures": _figures(sheet),
        "problems": _problems(sheet),
        "corrected": _list("What was corrected", sheet.corrected),
        "curves": "".join(
            f"<figure><figcaption>{escape(title)}</figcaption>{svg}</figure>"
            for title, svg in curve_panels(report, before)
        ),
        "before": '<span class="key ochre">joint angles copied, uncorrected</span>' if before is not None else "",
        "mapping": _mapping(bodies),
        "inferred": _list("What was inferred", sheet.inferred),
        "notes": _list("Warnings", sheet.notes),
        "scene": scene_json(bodies),
        "player": here.joinpath("player.js").read_text(encoding="utf-8"),
    }
    # Pieces of the template between names in double braces; what is put in is never looked at again.
    pieces = here.joinpath("page.html").read_text(encoding="utf-8").split("{{")
    page = [pieces[0]]
    for piece in pieces[1:]:
        name, rest = piece.split("}}", 1)
        page += [parts[name], rest]
    return "".join(page)


def _body_switches(bodies: Sequence[StageBody]) -> Iterator[str]:
    for number, body in enumerate(bodies):
        yield f'<label><input type="checkbox" data-body="{number}" checked> {escape(body.label)}</label> '


def _list(title: str, sentences: Sequence[str]) -> str:
    if not sentences:
        return ""
    return f"<h2>{title}</h2><ul>{''.join(f'<li>{escape(each)}</li>' for each in sentences)}</ul>"


def _problems(sheet: Sheet) -> str:
    if not sheet.problems:
        return "<h2>Findings</h2><p>Nothing that needs a look was found.</p>"
    rows = "".join(
        f'<li><button class="moment" data-time="{each.time:.3f}">{each.time:.2f} s</button> {escape(each.sentence)}</li>'
        for each in sheet.problems
    )
    return f"<h2>Findings, worst first</h2><ol>{rows}</ol>"


def _figures(sheet: Sheet) -> str:
    heads = "".join(f"<th>{escape(head)}</th>" for head in sheet.columns)
    rows = []
    for group, words, values, unit in sheet.rows:
        cells = "".join(f'<td class="number">{escape(value)}</td>' for value in values)
        first = ' class="first"' if group else ""
        rows.append(f"<tr{first}><th>{escape(group)}</th><td>{escape(words)}</td>{cells}<td>{escape(unit)}</td></tr>")
    return f"<table><thead><tr><th></th><th></th>{heads}<th></th></tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _mapping(bodies: Sequence[StageBody]) -> str:
    heads = "".join(f"<th>{escape(body.label)}</th>" for body in bodies)
    rows = []
    for name, told, joints in joint_table(bodies):
        cells = "".join(
            "<td>–</td>" if each is None else f"<td>{escape(each[0])} <small>{each[1]:.2f}</small></td>"
            for each in told
        )
        rows.append(f'<tr data-joints="{escape(str(joints))}"><td>{escape(name)}</td>{cells}</tr>')
    return f"<table class='mapping'><thead><tr><th>joint</th>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
