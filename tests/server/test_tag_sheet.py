"""Sheets with tags are what they say, once printed: rendered, measured and read by both libraries."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pypdfium2
import pytest
from numpy.typing import NDArray

from revnm_client.errors import ConfigError
from revnm_server.cli import main
from revnm_server.settings import load_settings
from revnm_server.tag import open_tag_library
from revnm_server.tag.choice import LIBRARIES, LibraryName
from revnm_server.tag.library import whole_picture
from revnm_server.tag.sheet import PAPERS_MM, checked_sheet, largest_size_mm

MM_PER_INCH = 25.4
DPI = 100.0


def page(pdf: Path, number: int = 0) -> NDArray[np.uint8]:
    """Return a page, (H, W) gray."""
    with pypdfium2.PdfDocument(pdf) as document:
        picture = document[number].render(scale=DPI / 72.0, grayscale=True).to_numpy()
        return np.array(picture).reshape(picture.shape[:2])


def longest_run(row: NDArray[np.bool_]) -> int:
    ends = np.flatnonzero(np.diff(np.pad(row, 1).astype(int)))
    return int((ends[1::2] - ends[::2]).max(initial=0))


def text(pdf: Path, number: int = 0) -> str:
    with pypdfium2.PdfDocument(pdf) as document:
        return str(document[number].get_textpage().get_text_range())


@pytest.mark.parametrize("name", LIBRARIES)
@pytest.mark.parametrize(("tag_id", "size_m", "paper"), [(3, 0.1, "a4"), (586, 0.155, "a4"), (0, 0.04, "letter")])
def test_a_printed_tag_is_read_with_its_size_and_its_front_up(
    tmp_path: Path, name: LibraryName, tag_id: int, size_m: float, paper: str
) -> None:
    pdf = tmp_path / "tag.pdf"
    assert main(["tag", "--id", str(tag_id), "--size", str(size_m), "--paper", paper, "--out", str(pdf)]) == 0
    gray = page(pdf)
    width_mm, height_mm = PAPERS_MM[paper]
    np.testing.assert_allclose(np.array(gray.shape) / DPI * MM_PER_INCH, [height_mm, width_mm], atol=0.5)
    (found,) = open_tag_library(name).library.detect(whole_picture(gray, decimation=1.0))
    assert found.tag_id == tag_id
    np.testing.assert_allclose(found.heading, [0.0, -1.0], atol=0.01)
    sides_px = np.linalg.norm(found.corners - np.roll(found.corners, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides_px / DPI * MM_PER_INCH, size_m * 1e3, atol=0.2)


def test_the_rim_is_white_and_the_cut_marks_and_the_ruler_are_true(tmp_path: Path) -> None:
    pdf = tmp_path / "tag.pdf"
    assert main(["tag", "--id", "3", "--size", "0.08", "--out", str(pdf)]) == 0
    ink = page(pdf) < 200
    px = DPI / MM_PER_INCH
    columns, rows = np.nonzero(ink.sum(axis=0) > 79 * px)[0], np.nonzero(ink.sum(axis=1) > 79 * px)[0]
    left, right, top = columns[0], columns[-1], rows[0]  # the black border's sides
    rim = 10.0 * px  # a cell
    for rows_of_rim, columns_of_rim in (
        (slice(int(top - rim + 1), top - 1), slice(int(left - rim + 1), int(right + rim))),
        (slice(top, int(top + 80 * px)), slice(int(left - rim + 1), left - 1)),
        (slice(top, int(top + 80 * px)), slice(right + 2, int(right + rim))),
        (slice(int(top + 80 * px) + 2, int(top + 80 * px + rim)), slice(int(left - rim + 1), int(right + rim))),
    ):
        assert not ink[rows_of_rim, columns_of_rim].any()
    marks = np.nonzero(ink[: int(top - rim), : int(left)].any(axis=0))[0]  # left of the arrow, before the tag
    assert marks[-1] == pytest.approx(left - rim, abs=1.5)
    ruler = max(longest_run(row) for row in ink[int(top + 80 * px + rim) :])
    assert ruler / px == pytest.approx(100.2, abs=0.5)  # its end lines are 0.2 mm wide


def test_a_page_for_each_tag_says_what_it_is_and_how_to_set_it(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pdf = tmp_path / "tags.pdf"
    assert main(["tag", "--id", "3", "--id", "7", "--size", "0.2", "--out", str(pdf)]) == 0
    assert "A3" in capsys.readouterr().out  # 0.2 m fits no A4
    for number, tag_id in enumerate((3, 7)):
        words = " ".join(text(pdf, number).split())
        for expected in (
            f"tag36h11 id {tag_id} 200 mm",
            "front of the robot",
            "The size, 200 mm, is that of the black square",
            "Print at 100 %",
            f"robots: {{rover: {tag_id}}}",
            "perception: {tag_size_m: 0.2}",
        ):
            assert expected in words
    config = tmp_path / "server.yaml"
    config.write_text("robots: {rover: 7}\nperception: {tag_size_m: 0.2}\n")  # as it is printed
    settings = load_settings(config)
    assert (settings.robots, settings.perception.tag_size_m) == ({"rover": 7}, 0.2)


def test_a_tag_that_does_not_fit_is_refused_with_what_would(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pdf = tmp_path / "tag.pdf"
    assert main(["tag", "--id", "3", "--size", "0.2", "--paper", "a4", "--out", str(pdf)]) == 2
    complaint = capsys.readouterr().err
    assert "0.155 at most" in complaint
    assert "--paper a3" in complaint
    assert main(["tag", "--id", "3", "--size", "1.0", "--out", str(pdf)]) == 2
    assert "no paper here holds it" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("paper", PAPERS_MM)
def test_the_largest_size_fits_and_a_larger_one_does_not(paper: str) -> None:
    largest = largest_size_mm(paper)
    assert checked_sheet(tag_id=0, size_mm=largest, paper=paper).paper == paper
    with pytest.raises(ConfigError, match=f"{largest / 1e3:g} at most"):
        checked_sheet(tag_id=0, size_mm=largest + 0.5, paper=paper)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--id", "587", "--size", "0.1"], "expected 0 to 586"),
        (["--id", "-1", "--size", "0.1"], "expected 0 to 586"),
        (["--id", "1", "--size", "nan"], "expected metres"),
        (["--id", "1", "--size", "-0.1"], "expected metres"),
        (["--id", "1", "--id", "1", "--size", "0.1"], "expected every tag once"),
        (["--id", "1", "--size", "0.1", "--out", "/dev/null/tag.pdf"], "--out /dev/null/tag.pdf: "),
    ],
)
def test_what_cannot_be_printed_is_told_in_a_line(
    words: list[str], complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["tag", *words]) == 2
    assert complaint in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_largest_square_of_a_page_is_upright_for_a_person_too(tmp_path: Path) -> None:
    # The arrow is nearer to the top of the page than the tag.
    pdf = tmp_path / "tag.pdf"
    assert main(["tag", "--id", "3", "--size", "0.1", "--out", str(pdf)]) == 0
    _, _, boxes, _ = cv2.connectedComponentsWithStats((page(pdf) < 128).astype(np.uint8))
    tag = boxes[1:][boxes[1:, cv2.CC_STAT_AREA].argmax()]
    arrow = boxes[1:][boxes[1:, cv2.CC_STAT_TOP].argmin()]
    assert arrow[cv2.CC_STAT_TOP] < tag[cv2.CC_STAT_TOP] / 2
