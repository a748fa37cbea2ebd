"""Boards drawn from their own descriptions, held every way, and found by OpenCV."""

import cv2
import numpy as np
import pytest

from jaxpoint.detection.board.abstract_board import BoardReason
from jaxpoint.detection.board.board_search import counts_of, detect_board, notes_of
from jaxpoint.detection.board.board_spec import read_board
from jaxpoint.errors import FileFormatError, InsufficientDataError, UsageError
from jaxpoint.io.board_sources import open_board_sources

SPECS = (
    "chessboard:9x6:25mm",
    "chessboard:7x7:2cm",
    "charuco:7x5:40mm:30mm:DICT_4X4_50",
    "charuco:6x6:0.03m:20mm:DICT_5X5_100:inverted",
    "aprilgrid:4x3:55mm:0.3",
)
PX = {"chessboard": 4.0, "charuco": 4.0, "aprilgrid": 4.0}  # a millimetre
WAYS = {"upright": 0, "quarter": 1, "half": 2, "three quarters": 3}


def drawn(board, margin=40):
    """The printed board, and where its points are in that image (K, 2)."""
    scale = PX[board.name]
    width, height = board.print_size_mm
    image = np.full((round(height * scale), round(width * scale)), 255, np.uint8)
    for left, top, wide, high in board.dark_mm() * scale:
        image[round(top) : round(top + high), round(left) : round(left + wide)] = 0
    image = cv2.copyMakeBorder(image, *(4 * [margin]), cv2.BORDER_CONSTANT, value=255)
    if getattr(board, "inverted", False):
        image = 255 - image
    flat = 1e3 * board.target.points[:, :2]
    corner = {"chessboard": 2.0, "charuco": 1.25, "aprilgrid": None}[board.name]
    if corner is None:
        first = 2 * 1e3 * board.tag_m * board.spacing * np.ones(2)
    else:
        first = corner * 1e3 * board.square_m * np.ones(2)
    return image, scale * (flat + first) + margin - 0.5


def warped(image, points, seed, turn=0, mirrored=False):
    """The board held somewhere, seen by a camera with noise and some blur; and its points in that image."""
    rng = np.random.default_rng(seed)
    height, width = image.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    size = np.array([1280, 960])
    target = corners / [width, height] * [760, 620] + [260, 170] + rng.uniform(-70, 70, (4, 2))
    target = np.roll(target, turn, axis=0).astype(np.float32)
    if mirrored:
        target[:, 0] = size[0] - 1 - target[:, 0]
    homography = cv2.getPerspectiveTransform(corners, target)
    finer = np.array([[3.0, 0, 1], [0, 3, 1], [0, 0, 1]])  # three samples a pixel, which no line slips through
    seen = cv2.warpPerspective(image, finer @ homography, tuple((3 * size).tolist()), borderValue=160)
    seen = cv2.resize(seen, tuple(size.tolist()), interpolation=cv2.INTER_AREA)
    seen = cv2.GaussianBlur(seen, (0, 0), 0.9).astype(float) * 0.7 + 30 + rng.normal(0, 2, seen.shape)
    there = cv2.perspectiveTransform(points[None].astype(np.float64), homography)[0]
    return np.clip(seen, 0, 255).astype(np.uint8), there


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("way", WAYS)
def test_every_corner_is_found_whichever_way_the_board_is_held(spec, way):
    board = read_board(spec)
    image, there = warped(*drawn(board), seed=WAYS[way], turn=WAYS[way])
    found = board.find(image)
    assert found is not None
    assert not found.mirrored
    if not board.ambiguous or way == "upright":  # of other turns a square board shows nothing
        off = np.linalg.norm(found.pixels - there[found.ids], axis=1)
        assert len(found.ids) >= 0.9 * len(there)
        assert np.median(off) < 0.12
        assert off.max() < 0.6


@pytest.mark.parametrize("spec", SPECS[2:])
def test_mirrored_boards_of_markers_are_found_and_named(spec):
    board = read_board(spec)
    image, there = warped(*drawn(board), seed=5, mirrored=True)
    found = board.find(image)
    assert found.mirrored
    assert np.median(np.linalg.norm(found.pixels - there[found.ids], axis=1)) < 0.12


def test_a_mirrored_chessboard_has_its_corners_in_an_order_that_a_plane_seen_from_its_front_has():
    """It looks like another board that is not mirrored; nothing can tell."""
    board = read_board("chessboard:9x6:25mm")
    grid = board.find(warped(*drawn(board), seed=5, mirrored=True)[0]).pixels.reshape(6, 9, 2)
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    assert across[0] * down[1] - across[1] * down[0] > 0


@pytest.mark.parametrize("spec", SPECS[2:])
def test_half_a_board_of_markers_is_enough(spec):
    board = read_board(spec)
    image, there = warped(*drawn(board), seed=3)
    image[:, 640:] = 128
    found = board.find(image)
    assert board.least_corners <= len(found.ids) < len(there)
    assert np.linalg.norm(found.pixels - there[found.ids], axis=1).max() < 0.6


def test_half_a_chessboard_is_no_board():
    board = read_board("chessboard:9x6:25mm")
    image, _ = warped(*drawn(board), seed=3)
    image[:, 640:] = 128
    assert board.find(image) is None


def test_ambiguous_boards():
    ambiguous = {spec: read_board(f"chessboard:{spec}:25mm").ambiguous for spec in ("9x6", "8x6", "7x7", "7x5", "6x9")}
    assert ambiguous == {"9x6": False, "8x6": True, "7x7": True, "7x5": True, "6x9": False}
    assert not read_board(SPECS[2]).ambiguous


@pytest.mark.parametrize("spec", SPECS)
def test_a_board_is_written_as_it_is_read(spec):
    board = read_board(spec)
    assert read_board(board.spec) == board


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two folders of images: sharp boards, none, and one that moves."""
    root, board = tmp_path_factory.mktemp("boards"), read_board(SPECS[2])
    page, points = drawn(board)
    for name, mirrored in (("left", False), ("right", True)):
        (root / name).mkdir()
        for number in range(3):
            image, _ = warped(page, points, seed=number, mirrored=mirrored)
            cv2.imwrite(str(root / name / f"{name}_{number}.png"), image)
        cv2.imwrite(str(root / name / f"{name}_3.png"), np.full((960, 1280), 90, np.uint8))
    smeared = cv2.blur(warped(page, points, seed=4)[0], (33, 1))
    cv2.imwrite(str(root / "left" / "left_4.png"), smeared)
    return root


def test_images_of_two_cameras_become_tracks(recording):
    board = read_board(SPECS[2])
    found = detect_board(open_board_sources([recording]), board)
    assert found.names == ("left", "right")
    assert counts_of(found, 0)["found"] == 3
    assert counts_of(found, 1) == {"found": 3, "not_found": 1, "no_image": 1}
    assert found.reasons[4, 0] in (BoardReason.BLURRED, BoardReason.NOT_FOUND)
    assert found.tracks.targets == (board.target,)
    assert sorted(set(found.tracks.frame_ids.tolist())) == [0, 1, 2]
    assert any("'right' are mirrored (3 of 3" in note for note in notes_of(found))
    alone = detect_board(open_board_sources([recording / "left" / "left_*.png"]), board)
    assert alone.names == ("left",)
    np.testing.assert_array_equal(alone.tracks.pixels[:, 0], found.tracks.pixels[:, 0])


def test_a_board_that_is_nowhere_is_an_error_with_the_remedy(recording):
    with pytest.raises(InsufficientDataError, match=r"aprilgrid:4x3:55mm:0.3 was found in 0 of 9 images.*counted"):
        detect_board(open_board_sources([recording]), read_board(SPECS[4]))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("chess:9x6:25mm", "no board 'chess:9x6:25mm'; write chessboard:9x6:25mm"),
        ("chessboard:9x6:25", "'25' of the board's square has no unit; write 25mm"),
        ("chessboard:9x6", "do not fit its kind"),
        ("chessboard:9x2:25mm", "9 x 2 inner corners is too small: each side needs 3"),
        ("chessboard:9x6:25km", "is .25k., which is no number"),
        ("chessboard:9x6:-2mm", "must be above 0"),
        ("chessboard:9x6:nanmm", "is no number"),
        ("chessboard:9x6:25mm:3", "do not fit its kind"),
        ("charuco:7x5:30mm:40mm", "40 mm is not below 30 mm"),
        ("charuco:7x5:40mm:30mm:DICT_9", "no dictionary of markers 'DICT_9'"),
        ("charuco:40x30:40mm:30mm:DICT_4X4_50", "needs 600 markers, but DICT_4X4_50 has 50"),
        ("charuco:7x5:40mm:30mm:DICT_4X4_50:black", "may only be 'inverted', not 'black'"),
        ("aprilgrid:6x6:55mm", "do not fit its kind"),
        ("aprilgrid:6x6:55mm:x", "spacing of the board is 'x', which is no number"),
        ("aprilgrid:40x40:55mm:0.3", "needs 1600 markers"),
    ],
)
def test_descriptions_that_are_none_are_refused(spec, message):
    with pytest.raises(UsageError, match=message):
        read_board(spec)


def test_a_board_from_toml(tmp_path):
    file = tmp_path / "board.toml"
    file.write_text(
        '[board]\nkind = "charuco"\ncolumns = 7\nrows = 5\nsquare = "40mm"\nmarker = "3cm"\nsize_sigma = 0.01\n'
    )
    board = read_board(str(file))
    assert board.spec == SPECS[2]
    assert board.target.size_sigma == 0.01
    file.write_text('[board]\nkind = "chessboard"\ncolumns = 7\nrows = 5\nsqare = "40mm"\n')
    with pytest.raises(UsageError, match="unknown key 'sqare'"):
        read_board(str(file))
    file.write_text('[board]\nkind = "chessboard"\ncolumns = 7\nrows = 5\n')
    with pytest.raises(UsageError, match="lacks its 'square'"):
        read_board(str(file))
    file.write_text("[board\n")
    with pytest.raises(FileFormatError, match="is not TOML"):
        read_board(str(file))
    with pytest.raises(FileFormatError, match="no file"):
        read_board(str(tmp_path / "none.toml"))


def test_the_board_of_the_real_sample(data_folder):
    """By the source's own test: 54 corners in frame 100, none in frame 0, one order in all four cameras."""
    board = read_board("chessboard:6x9:25mm")
    folder = data_folder / "caliscope_chess_intrinsic"
    read = {file.stem: cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in sorted(folder.glob("*.jpg"))}
    assert len(board.find(read["cam_0_frame_100"]).ids) == 54
    assert board.find(read["cam_0_frame_000"]) is None
    grids = [board.find(read[f"cam_{c}_frame_1070"]).pixels.reshape(9, 6, 2) for c in range(4)]
    for grid in grids:
        across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
        assert across[0] * down[1] - across[1] * down[0] > 0
        # The first corner lies inside of a dark square in every camera.
        x, y = np.rint((grid[0, 0] + grid[1, 1]) / 2).astype(int)
        ox, oy = np.rint((grid[0, 1] + grid[1, 2]) / 2).astype(int)
        image = read[f"cam_{next(c for c, other in enumerate(grids) if other is grid)}_frame_1070"]
        assert image[y, x] < image[oy, ox]
