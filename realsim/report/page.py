"""Self-contained report pages: pieces of HTML, and the document that holds them.

Every function returns a piece of HTML as text. Text that comes from data goes through `esc`; pieces made here are
passed on as they are. A page needs no network: style, scripts, pictures and meshes are inside it.
"""

import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from html import escape
from importlib.resources import files
from typing import Any, Literal

from realsim import __version__

Level = Literal["good", "look", "bad"]
WORDS: dict[Level, str] = {"good": "Good", "look": "Check first", "bad": "Do not use"}


def esc(value: Any) -> str:
    """Text made safe for HTML."""
    return escape(str(value), quote=True)


def prose(text: str) -> str:
    """A sentence made safe for HTML; what stands between backticks in it is something to type."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", esc(text))


def asset(name: str) -> str:
    """Text of a file that lies beside this module."""
    return files("realsim.report").joinpath(name).read_text(encoding="utf-8")


def badge(level: Level, text: str = "") -> str:
    """A small coloured word."""
    return f'<span class="badge {level}">{esc(text or WORDS[level])}</span>'


def verdict(level: Level, headline: str, reasons: Sequence[str], steps: Sequence[str] = ()) -> str:
    """The banner at the top: the verdict, its reasons, one sentence each, less the headline, and what to do next."""
    rest = [r for r in reasons if r != headline]
    return (
        f'<section class="verdict {level}"><div class="word">{WORDS[level]}</div><div><h2>{prose(headline)}</h2>'
        f"{folded_bullets(rest, 'more', 5) if rest else ''}{f'<h4>Next</h4>{bullets(steps)}' if steps else ''}"
        "</div></section>"
    )


def facts(items: Sequence[tuple[str, str, str]]) -> str:
    """Large figures: (name, value with unit, what it means)."""
    cells = "".join(
        f'<div class="fact"><span>{esc(name)}</span><b>{esc(value)}</b><small>{esc(note)}</small></div>'
        for name, value, note in items
    )
    return f'<section class="facts">{cells}</section>'


def card(title: str, body: str, note: str = "", *, wide: bool = False) -> str:
    """A framed part of the page; `note` says how to read it. `wide` takes the whole width of the page."""
    text = f'<p class="note">{prose(note)}</p>' if note else ""
    return f'<section class="card{" wide" if wide else ""}"><h3>{esc(title)}</h3>{text}{body}</section>'


def folded(title: str, body: str) -> str:
    """A card that is closed until it is opened."""
    return f'<details class="card"><summary><h3>{esc(title)}</h3></summary>{body}</details>'


def grid(*cards: str) -> str:
    """Cards side by side where there is room."""
    return f'<div class="grid">{"".join(cards)}</div>'


def columns(left: Sequence[str], right: Sequence[str]) -> str:
    """Two stacks of cards side by side; one after the other on a phone."""
    return grid(*(f'<div class="stack">{"".join(cards)}</div>' for cards in (left, right)))


def table(head: Sequence[str], rows: Sequence[Sequence[str]], *, raw: Sequence[int] = ()) -> str:
    """A table of texts; columns in `raw` already hold HTML. Wide tables scroll on their own."""

    def cell(i: int, value: str) -> str:
        return f'<td data-head="{esc(head[i])}">{value if i in raw else esc(value)}</td>'

    top = "".join(f"<th>{esc(h)}</th>" for h in head)
    body = "".join(f"<tr>{''.join(cell(i, v) for i, v in enumerate(row))}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def bullets(items: Sequence[str], empty: str = "none") -> str:
    """A plain list of sentences."""
    if not items:
        return f'<p class="note">{prose(empty)}</p>'
    return "<ul>" + "".join(f"<li>{prose(i)}</li>" for i in items) + "</ul>"


def folded_bullets(items: Sequence[str], what: str, shown: int = 3) -> str:
    """The first few sentences, and the others folded; `what` names them ("more objects")."""
    rest = items[shown:]
    return bullets(items[:shown]) + (fold(f"{len(rest)} {what}", bullets(rest)) if rest else "")


def links(files: Sequence[tuple[str, str]]) -> str:
    """Files that lie beside the page: (name, what it is)."""
    rows = [[f'<a href="{esc(name)}">{esc(name)}</a>', what] for name, what in files]
    return table(["file", ""], rows, raw=[0])


def code(text: str) -> str:
    """Text to copy, with a button that does."""
    return (
        '<div class="code"><button type="button" onclick="navigator.clipboard.writeText('
        "this.nextElementSibling.textContent).then(()=>{this.textContent='copied'})\">copy</button>"
        f"<pre>{esc(text)}</pre></div>"
    )


def thumbnails(items: Sequence[tuple[str, str, str]]) -> str:
    """Small pictures: (data URI, caption, more on hover)."""
    cells = "".join(
        f'<figure title="{esc(more)}"><img src="{uri}" alt="{esc(caption)}">'
        f"<figcaption>{esc(caption)}</figcaption></figure>"
        for uri, caption, more in items
    )
    return f'<div class="thumbs">{cells}</div>'


def legend(items: Sequence[tuple[str, str]]) -> str:
    """Names, each beside its colour; nothing without any."""
    rows = "".join(f'<span><i style="background:{fill}"></i>{esc(name)}</span>' for name, fill in items)
    return f'<div class="legend">{rows}</div>' if rows else ""


def fold(summary: str, body: str) -> str:
    """A part that is closed until it is requested."""
    return f"<details><summary>{esc(summary)}</summary>{body}</details>"


def now() -> str:
    """The date that pages state, to the minute, UTC: now, or SOURCE_DATE_EPOCH (reproducible-builds.org) where it is
    set, for pages that are to be the same bytes."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    date = datetime.fromtimestamp(int(epoch), UTC) if epoch.isdigit() else datetime.now(UTC)
    return f"{date:%Y-%m-%d %H:%M} UTC"


def document(title: str, subtitle: str, body: str, *, scripts: Sequence[str] = ()) -> str:
    """The whole page.

    Args:
        title: what the report is about.
        subtitle: one line below it (source, backend).
        body: pieces from this module.
        scripts: JavaScript texts to run after the body (`viewer3d.script()` where there is a 3D view).
    """
    tags = "".join(f"<script>{s}</script>" for s in scripts)
    footer = f"<footer>realsim {__version__}, {now()}</footer>"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1"><meta name="color-scheme" '
        f'content="light dark"><title>{esc(title)}</title><link rel="icon" href="data:,">'
        f"<style>{asset('style.css')}</style></head><body><main>"
        f"<header><h1>{esc(title)}</h1><p>{esc(subtitle)}</p></header>{body}{footer}</main>{tags}</body></html>\n"
    )
