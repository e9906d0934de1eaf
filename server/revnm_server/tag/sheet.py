"""Sheets of paper with tags to cut out: true to size, as a PDF of nothing but filled shapes and text.

The piece that is cut out is the tag with its white rim, and behind it a strip with the tag's name, so that the piece on
the robot still says which tag it is and which edge lies in front.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas

from revnm_client.errors import ConfigError
from revnm_server.tag.family import CELLS, FAMILY, RIM_CELLS, TAGS, upright_cells

PAPERS_MM = {"a4": (210.0, 297.0), "letter": (215.9, 279.4), "a3": (297.0, 420.0), "a2": (420.0, 594.0)}
SMALLEST_MM = 10.0

_EDGE_MM = 8.0  # which printers leave white; the cut marks reach into it
_FRONT_MM = 15.0  # for the arrow, before the tag
_STRIP_MM = 7.0  # behind the tag, cut out with it
_TEXT_MM = 44.0  # below it: ruler and settings
_MARK_MM = (1.0, 6.0)  # a cut mark's ends, from the piece's corner
_RULER_MM = 100
_RIM = (CELLS + 2 * RIM_CELLS) / CELLS  # side of the white rim, in sides of the border


@dataclass(frozen=True, slots=True)
class Sheet:
    """What is printed.

    Attributes:
        tag_id: Which tag of the family.
        size_mm: Side of the black square.
        paper: A key of :data:`PAPERS_MM`.
    """

    tag_id: int
    size_mm: float
    paper: str


def largest_size_mm(paper: str) -> float:
    """Return the largest tag that fits a paper, whole millimetres."""
    width, height = PAPERS_MM[paper]
    across = width - 2 * _EDGE_MM
    along = height - 2 * _EDGE_MM - _FRONT_MM - _STRIP_MM - _TEXT_MM
    return float(math.floor(min(across, along) / _RIM))


def smallest_paper(size_mm: float) -> str | None:
    """Return the smallest paper that a tag fits, of the A series, or None."""
    return next((paper for paper in ("a4", "a3", "a2") if size_mm <= largest_size_mm(paper)), None)


def checked_sheet(*, tag_id: int, size_mm: float, paper: str | None) -> Sheet:
    """Return a sheet that can be printed.

    Args:
        tag_id: Which tag of the family.
        size_mm: Side of the black square.
        paper: Which paper; None takes the smallest that it fits.

    Raises:
        ConfigError: There is no such tag, or it does not fit.
    """
    if not 0 <= tag_id < TAGS:
        raise ConfigError(f"--id {tag_id}: expected 0 to {TAGS - 1}, the tags of {FAMILY}")
    if not (math.isfinite(size_mm) and size_mm >= SMALLEST_MM):
        raise ConfigError(f"--size {size_mm / 1e3:g}: expected metres, at least {SMALLEST_MM / 1e3:g}")
    fitting = smallest_paper(size_mm)
    chosen = paper or fitting or "a2"
    if size_mm <= largest_size_mm(chosen):
        return Sheet(tag_id, size_mm, chosen)
    other = f"--paper {fitting} holds it" if fitting else "no paper here holds it: draw it by hand or have it plotted"
    raise ConfigError(
        f"--size {size_mm / 1e3:g}: with its white rim it does not fit {chosen}, which holds "
        f"{largest_size_mm(chosen) / 1e3:g} at most; {other}"
    )


def render_sheets(sheets: Sequence[Sheet]) -> bytes:
    """Return a PDF with a page for each sheet; the same sheets give the same bytes."""
    buffer = io.BytesIO()
    canvas = Canvas(buffer, invariant=1)
    canvas.setTitle(f"{FAMILY}: {', '.join(str(sheet.tag_id) for sheet in sheets)}")
    for sheet in sheets:
        width, height = PAPERS_MM[sheet.paper]
        canvas.setPageSize((width * mm, height * mm))
        canvas.scale(mm, mm)  # from here on all is in millimetres, up from the lower left corner
        _draw(canvas, sheet)
        canvas.showPage()
    canvas.save()
    return buffer.getvalue()


def _draw(canvas: Canvas, sheet: Sheet) -> None:
    width, height = PAPERS_MM[sheet.paper]
    rim = sheet.size_mm * _RIM
    left = (width - rim) / 2
    top = height - _EDGE_MM - _FRONT_MM
    bottom = top - rim - _STRIP_MM
    _draw_front(canvas, width / 2, top)
    _draw_cells(canvas, sheet, left, top - rim)
    _draw_cut_marks(canvas, left, bottom, left + rim, top)
    label = f"{FAMILY}  id {sheet.tag_id}  {sheet.size_mm:g} mm   rear"
    font_mm = min(3.2, 1.6 * rim / len(label))
    canvas.setFont("Helvetica", font_mm)
    canvas.drawCentredString(width / 2, bottom + 0.5 * (_STRIP_MM - font_mm), label)
    _draw_ruler(canvas, _EDGE_MM + 4.0, bottom - 17.0)
    _draw_notes(canvas, sheet, _EDGE_MM + 4.0, bottom - 25.0)


def _draw_front(canvas: Canvas, middle: float, top: float) -> None:
    """Draw the arrow that points to the robot's front."""
    arrow = canvas.beginPath()
    arrow.moveTo(middle, top + 13.5)
    for x, y in ((4.0, 8.0), (1.2, 8.0), (1.2, 3.0), (-1.2, 3.0), (-1.2, 8.0), (-4.0, 8.0)):
        arrow.lineTo(middle + x, top + y)
    arrow.close()
    canvas.drawPath(arrow, stroke=0, fill=1)
    canvas.setFont("Helvetica-Bold", 4.5)
    canvas.drawString(middle + 6.0, top + 6.0, "front of the robot")


def _draw_cells(canvas: Canvas, sheet: Sheet, left: float, bottom: float) -> None:
    """Draw the black cells as one shape, so that no seam shows between them."""
    cell = sheet.size_mm / CELLS
    path = canvas.beginPath()
    for row, whites in enumerate(upright_cells(sheet.tag_id)):
        for column, white in enumerate(whites):
            if not white:
                x = left + (column + RIM_CELLS) * cell
                path.rect(x, bottom + (CELLS - 1 - row + RIM_CELLS) * cell, cell, cell)
    canvas.drawPath(path, stroke=0, fill=1)


def _draw_cut_marks(canvas: Canvas, left: float, bottom: float, right: float, top: float) -> None:
    canvas.setLineWidth(0.15)
    near, far = _MARK_MM
    for x, outwards in ((left, -1), (right, 1)):
        for y, upwards in ((bottom, -1), (top, 1)):
            canvas.line(x + outwards * near, y, x + outwards * far, y)
            canvas.line(x, y + upwards * near, x, y + upwards * far)


def _draw_ruler(canvas: Canvas, left: float, bottom: float) -> None:
    canvas.setLineWidth(0.2)
    canvas.line(left, bottom, left + _RULER_MM, bottom)
    for millimetre in range(0, _RULER_MM + 1, 5):
        canvas.line(left + millimetre, bottom, left + millimetre, bottom + (4.0 if millimetre % 10 == 0 else 2.0))
    canvas.setFont("Helvetica", 3.2)
    canvas.drawString(left + _RULER_MM + 3.0, bottom + 0.5, f"{_RULER_MM} mm: measure it before you cut")


def _draw_notes(canvas: Canvas, sheet: Sheet, left: float, top: float) -> None:
    canvas.setFont("Helvetica", 3.4)
    size_m = f"{sheet.size_mm / 1e3:g}"
    lines = (
        f"The size, {sheet.size_mm:g} mm, is that of the black square, from edge to edge, without the white rim.",
        "Print at 100 %, not fitted to the page. Cut at the marks. Matt paper, flat on a stiff plate.",
        f"Settings:  robots: {{rover: {sheet.tag_id}}}     perception: {{tag_size_m: {size_m}}}",
    )
    for number, line in enumerate(lines):
        canvas.drawString(left, top - 5.0 * number, line)
