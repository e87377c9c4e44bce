"""The pieces of a report as markup of one page."""

from __future__ import annotations

from collections.abc import Iterable

from hil.app.report import markup
from hil.app.report.blocks import (
    Block,
    Bullets,
    DataTable,
    Drawing,
    Facts,
    Finding,
    Heading,
    Paragraph,
    Table,
    Tile,
    Tiles,
)
from hil.app.report.svg import PAGE, inline_svg


def html(blocks: Iterable[Block]) -> str:
    """All of them, a line each."""
    return "\n".join(part for part in map(_block, blocks) if part)


def _block(block: Block) -> str:  # noqa: PLR0911  (one for each kind)
    match block:
        case Heading():
            tag = f'<span class="tag">{markup.text(block.tag)}</span>' if block.tag else ""
            return f"<h{block.level}>{markup.text(block.text)}{tag}</h{block.level}>"
        case Paragraph():
            return _paragraph(block)
        case Bullets():
            return markup.paragraph_list(block.items, block.style)
        case Tiles():
            return '<div class="tiles">' + "".join(map(_tile, block.tiles)) + "</div>"
        case Facts():
            return markup.definitions(block.facts)
        case Table():
            css = {"meaning": "numbers meaning"}.get(block.style, block.style)
            return markup.table(block.head, block.rows, css=css, caption=block.caption)
        case DataTable():
            return markup.data_table(
                block.identifier, block.title, block.columns, heads=block.heads, unfolded=block.unfolded
            )
        case Drawing():
            svg = inline_svg(block.figure(PAGE), block.key, block.description)
            return markup.figure(svg, block.caption)
        case Finding():
            return f'<section class="finding">{html(block.blocks)}</section>'


def _paragraph(block: Paragraph) -> str:
    css = f' class="{block.style}"' if block.style else ""
    words = []
    for span in block.spans:
        said = markup.text(span.text)
        match span.style:
            case "strong":
                said = f"<strong>{said}</strong>"
            case "muted":
                said = f'<span class="muted">{said}</span>'
        words.append(said)
    return f"<p{css}>{''.join(words)}</p>"


def _tile(tile: Tile) -> str:
    css = {True: "better", False: "worse", None: ""}[tile.good]
    unit = f" <small>{markup.text(tile.unit)}</small>" if tile.unit else ""
    below = markup.text(tile.below)
    if tile.verdict:
        below += f' <span class="{css}">{markup.text(tile.verdict)}</span>'
    under = f'<div class="from">{below}</div>' if below else ""
    on_value = f" {css}" if css and not tile.verdict else ""
    return (
        f'<div class="tile"><div class="name">{markup.text(tile.name)}</div>'
        f'<div class="value{on_value}">{markup.text(tile.value)}{unit}</div>{under}</div>'
    )
