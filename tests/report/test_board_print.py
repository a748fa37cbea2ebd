"""The printed board: its true size, and that it is the board that is found."""

import re
import zlib

import cv2
import numpy as np
import pytest

from jaxpoint.cli import main
from jaxpoint.detection.board.board_spec import read_board
from jaxpoint.report.board_print import svg_of, write_board

SPECS = ("chessboard:9x6:25mm", "charuco:7x5:40mm:30mm:DICT_4X4_50", "aprilgrid:4x3:55mm:0.3")


@pytest.mark.parametrize("spec", SPECS)
def test_the_svg_is_found_at_its_stated_size(spec):
    board, scale = read_board(spec), 4.0  # px a millimetre
    text = svg_of(board)
    width, height = (float(re.search(rf'^<svg .*?{side}="([\d.]+)mm"', text)[1]) for side in ("width", "height"))
    assert f'viewBox="0 0 {width:.4f} {height:.4f}"' in text
    image = np.full((round(scale * height) + 100, round(scale * width) + 100), 255, np.uint8)
    for x, y, w, h in re.findall(r"M([\d.]+) ([\d.]+)h([\d.]+)v([\d.]+)h-", text):
        left, top = (round(scale * float(value)) + 50 for value in (x, y))
        right, low = (round(scale * (float(a) + float(b))) + 50 for a, b in ((x, w), (y, h)))
        image[top:low, left:right] = 0
    found = board.find(cv2.GaussianBlur(image, (0, 0), 1.0))
    stated = scale * 1e3 * board.target.points[found.ids, :2]
    np.testing.assert_allclose(found.pixels - found.pixels.mean(0), stated - stated.mean(0), atol=0.3)


def test_the_pdf_has_the_same_size(tmp_path):
    board, path = read_board(SPECS[0]), tmp_path / "board.pdf"
    write_board(path, board)
    data = path.read_bytes()
    streams = [zlib.decompress(part) for part in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL)[:1]]
    box = re.search(rb"/MediaBox \[ ?([\d. ]+)\]", data)[1].split()
    width, height = board.print_size_mm
    np.testing.assert_allclose([float(v) for v in box[2:]], np.array([width, height + 12]) * 72 / 25.4, atol=0.01)
    assert streams


def test_the_command_writes_and_refuses(tmp_path, capsys):
    out = tmp_path / "board.svg"
    assert main(["board", "chessboard:8x6:25mm", "--out", str(out)]) == 0
    assert "looks the same turned by 180 degrees" in capsys.readouterr().out
    assert out.read_text().startswith("<svg")
    assert main(["board", "chessboard:8x6:25mm", "--out", str(out)]) == 2
    assert main(["board", "chessboard:8x6:25mm", "--out", str(tmp_path / "board.png")]) == 2
    assert "ends in .svg or .pdf" in capsys.readouterr().err
