"""The top of the page: the table to decide by and two figures; and the comparisons behind the table."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.cells import SUBJECT, family
from hhtbench.campaign.analysis.kinds import Kind
from hhtbench.report.colours import SolverStyle
from hhtbench.report.content import Content
from hhtbench.report.decisions import evidence_anchor
from hhtbench.report.drawings import Drawings
from hhtbench.report.elements import folded, html_table
from hhtbench.report.overview import drift_views, profile_views
from hhtbench.report.tables import Table
from hhtbench.report.wording import anchor
from hhtbench.report.words import SHORT, bound_label, plural


def decision_section(tables: Mapping[tuple[str, float | None], Table]) -> str:
    """Buttons for measure and bound of the drift, and a table for each choice; the first is shown."""
    measures, bounds = (list(dict.fromkeys(values)) for values in zip(*tables, strict=True))
    shown = "\n".join(
        f'<div data-table="{measure} {bound_label(bound)}"{"" if number == 0 else " hidden"}>{html_table(table)}</div>'
        for number, ((measure, bound), table) in enumerate(tables.items())
    )
    return f"""\
<section class="decision" id="decision">
<div class="choose"><span>by {_buttons({name: SHORT[name] for name in measures})}</span>
<span>drift {_buttons({bound_label(bound): bound_label(bound) for bound in bounds})}</span></div>
{shown}
</section>"""


def _buttons(named: Mapping[str, str]) -> str:
    first = next(iter(named))
    return "".join(
        f'<button type="button" data-choice="{escape(name)}" aria-pressed="{str(name == first).lower()}">'
        f"{escape(text)}</button>"
        for name, text in named.items()
    )


def overview(content: Content, styles: Mapping[str, SolverStyle], drawings: Drawings) -> str:
    """The two figures, as far as rows allow."""
    front = {
        place.entry
        for choice in analysis.decide(content.rows, content.kinds, "time", content.targets)
        for place in (*choice.places[:2], *[place for place in choice.places if family(place.entry) == SUBJECT][:1])
    }
    found = {
        "Drift against cost at equal accuracy": drift_views(content.rows, styles),
        "Errors reached within a cost": profile_views(content.rows, styles, front),
    }
    return "\n".join(figure_of(title, title, views, drawings) for title, views in found.items() if views)


def figure_of(identifier: str, title: str, views: Mapping[str, tuple[Any, str]], drawings: Drawings) -> str:
    """A figure with its views."""
    return f"""\
<figure id="{anchor(identifier)}">
<h3>{escape(title)}</h3>
{drawings.views(views)}
</figure>"""


def evidence_section(kind: Kind, content: Content, page: Drawings) -> str:
    """The problems of one kind, each with its own comparison."""
    links = ", ".join(f'<a href="#{anchor(name)}">{escape(name)}</a>' for name in content.kinds[kind])
    packed = page.part().packed(html=f'<p class="note">{links}</p>\n{html_table(content.against[kind])}')
    return folded(
        evidence_anchor(kind), f"<h3>{escape(kind.text)}</h3> {plural(len(content.kinds[kind]), 'problem')}", packed
    )
