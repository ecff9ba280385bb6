# SPDX-License-Identifier: Apache-2.0
"""Calibration recovers a rendered camera; bad sets are refused by name; the printed target is true to scale."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from softgrip_testing.synthetic_boards import POSES, BoardCamera
from softgrip_testing.synthetic_images import make_calibration
from softgrip_vision import calibration as files
from softgrip_vision.calibrating import (
    Board,
    BoardView,
    calibrate_lens,
    calibrate_plane,
    collect_views,
    has_charuco,
)
from softgrip_vision.calibrating.target_pdf import cross_origin, draw_target, write_target
from softgrip_vision.calibration import Lens, PlaneMap
from softgrip_vision.commands import calibrate_camera
from softgrip_vision.errors import CalibrationError
from softgrip_vision.sources import open_source

#: a chessboard looks the same upside down, and the command is asked for ChArUco
needs_charuco = pytest.mark.skipif(not has_charuco(), reason="OpenCV 4.7 or later finds ChArUco boards")
BOARD = Board(11, 7, 0.024)
WIDTH, HEIGHT = 960, 540
TRUE = Lens(
    WIDTH,
    HEIGHT,
    np.array([[905.0, 0.0, 486.0], [0.0, 908.0, 263.0], [0.0, 0.0, 1.0]]),
    np.array([-0.15, 0.06, 8e-4, -5e-4, 0.0]),
    "truth",
)


@pytest.fixture(scope="module")
def camera() -> BoardCamera:
    return BoardCamera(TRUE, BOARD)


@pytest.fixture(scope="module")
def pictures(camera: BoardCamera) -> list[np.ndarray]:
    return [camera.picture(*camera.centred(np.array(turn), at, away)) for at, turn, away in POSES]


@pytest.fixture(scope="module")
def views(pictures: list[np.ndarray]) -> list[BoardView]:
    found = [BOARD.find(picture, f"view {number}") for number, picture in enumerate(pictures)]
    assert all(found)
    return [view for view in found if view is not None]


def test_intrinsics_of_a_rendered_camera_come_back(views: list[BoardView]) -> None:
    fit = calibrate_lens(views)
    assert fit.lens.matrix[(0, 1), (0, 1)] == pytest.approx([905.0, 908.0], rel=3e-3)
    assert fit.lens.matrix[:2, 2] == pytest.approx([486.0, 263.0], abs=0.003 * WIDTH)
    assert fit.rms_px < 0.2
    # What matters: pixels are straightened as the true lens would, all over the image.
    grid = np.stack(np.meshgrid(np.linspace(40, WIDTH - 40, 9), np.linspace(40, HEIGHT - 40, 7)), -1).reshape(-1, 2)
    ours = (fit.lens.undistort(grid) - fit.lens.matrix[:2, 2]) / fit.lens.matrix[(0, 1), (0, 1)]
    true = (TRUE.undistort(grid) - TRUE.matrix[:2, 2]) / TRUE.matrix[(0, 1), (0, 1)]
    assert np.abs(ours - ours.mean(0) - true + true.mean(0)).max() * 905 < 2.0


def test_scale_of_a_plane_comes_back(camera: BoardCamera) -> None:
    turn, place = camera.centred(np.array([0.12, -0.08, 0.05]), (480, 270), 0.45)
    view = BOARD.find(camera.picture(turn, place))
    assert view is not None
    fit = calibrate_plane([view], TRUE, (0.0, 0.0))
    # Two points 100 mm apart on the board, projected by the true camera.
    ends = np.array([[0.05, 0.05, 0.0], [0.15, 0.05, 0.0], [0.05, 0.15, 0.0]])
    pixels = cv2.projectPoints(ends, turn, place, TRUE.matrix, TRUE.distortion)[0].reshape(-1, 2)
    plane = files.FingerPlane("index", fit.homography, 0.02, 0.005)
    found = PlaneMap(TRUE, plane).to_plane(pixels)
    assert np.hypot(*(found[1] - found[0])) == pytest.approx(0.1, rel=2e-3)
    assert np.hypot(*(found[2] - found[0])) == pytest.approx(0.1, rel=2e-3)
    assert found == pytest.approx(ends[:, :2] * [1, -1], abs=2e-4)


def test_few_views_are_refused(views: list[BoardView]) -> None:
    with pytest.raises(CalibrationError, match="expected at least 8 different views"):
        calibrate_lens(views[:5])


def test_views_from_one_side_are_refused_with_what_to_add(camera: BoardCamera) -> None:
    flat = []
    for number in range(9):
        turn, place = camera.centred(np.array([0.02, 0.01, 0.0]), (330 + 8 * number, 200 + 5 * number), 0.6)
        view = BOARD.find(camera.picture(turn, place), f"view {number}")
        assert view is not None
        flat.append(view)
    with pytest.raises(CalibrationError, match="add views") as refused:
        calibrate_lens(flat)
    assert "bottom right" in str(refused.value)
    assert "tilted" in str(refused.value)


def test_a_spoilt_view_is_named(views: list[BoardView]) -> None:
    spoilt = views[4]
    shaken = spoilt.pixels + np.random.default_rng(1).normal(0, 6.0, spoilt.pixels.shape)
    bad = BoardView("view 4", spoilt.points, shaken, spoilt.size)
    with pytest.raises(CalibrationError, match=r"take again.*view 4"):
        calibrate_lens([*views[:4], bad, *views[5:]])


def test_a_bent_board_is_refused(camera: BoardCamera) -> None:
    turn, place = camera.centred(np.array([0.1, 0.0, 0.0]), (480, 270), 0.45)
    view = BOARD.find(camera.picture(turn, place))
    assert view is not None
    bent = BoardView("bent", view.points, view.pixels + 20 * (view.points[:, :1] - 0.13) ** 2 * 100, view.size)
    with pytest.raises(CalibrationError, match="flat and still"):
        calibrate_plane([bent], TRUE, (0.0, 0.0))
    with pytest.raises(CalibrationError, match="0 views"):
        calibrate_plane([], TRUE, (0.0, 0.0))


def test_a_chessboard_is_found_too(camera: BoardCamera) -> None:
    board = Board(11, 7, 0.024, charuco=False)
    chess = BoardCamera(TRUE, board)
    turn, place = chess.centred(np.array([0.2, 0.1, 0.0]), (480, 270), 0.5)
    view = board.find(chess.picture(turn, place))
    assert view is not None
    points = np.column_stack([view.points, np.zeros(len(view.points))])
    pixels = cv2.projectPoints(points, turn, place, TRUE.matrix, TRUE.distortion)[0].reshape(-1, 2)
    assert np.hypot(*(view.pixels - pixels).T).max() < 0.3


def test_views_that_show_nothing_new_are_left_out(tmp_path: Path, pictures: list[np.ndarray]) -> None:
    for number, picture in enumerate([pictures[0], pictures[0], pictures[1], np.zeros_like(pictures[0])]):
        cv2.imwrite(str(tmp_path / f"{number}.png"), picture)
    read = []
    kept = collect_views(open_source(str(tmp_path)), BOARD, max_frames=100, progress=lambda n, k: read.append((n, k)))
    assert len(kept) == 2
    assert read[-1] == (4, 2)


@needs_charuco
def test_printed_squares_have_their_true_size() -> None:
    """The page at 300 dots an inch, through the board finder: one square is 24 mm."""
    figure = draw_target(BOARD, "A3", base_marker_m=0.02)
    figure.set_dpi(300)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    page = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, :3])
    view = BOARD.find(page)
    assert view is not None
    assert len(view.points) == 60
    across = np.linalg.lstsq(np.column_stack([view.points, np.ones(60)]), view.pixels, rcond=None)[0]
    dots_per_metre = 300 / 0.0254
    assert across[:2] == pytest.approx(np.eye(2) * dots_per_metre, rel=1e-4, abs=1.0)


def test_the_pdf_has_the_paper_and_the_squares_in_points(tmp_path: Path) -> None:
    path = tmp_path / "board.pdf"
    write_target(draw_target(Board(9, 6, 0.024), "A4"), path)
    data = path.read_bytes()
    box = re.search(rb"/MediaBox \[ ([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) \]", data)
    assert box is not None
    points = [float(text) / 72 * 25.4 for text in box.groups()]
    assert points == pytest.approx([0, 0, 297, 210], abs=0.01)
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL)
    drawing = b"".join(zlib.decompress(s) for s in streams if s[:1] == b"x")
    corners = [float(x) for x in re.findall(rb"([\d.]+) [\d.]+ m", drawing)]
    assert min(corners, key=lambda x: abs(x - 10 / 25.4 * 72)) == pytest.approx(10 / 25.4 * 72, abs=0.01)


def test_a_board_too_large_for_the_page_is_refused() -> None:
    with pytest.raises(CalibrationError, match="fits A4"):
        draw_target(Board(20, 10, 0.024), "A4")
    with pytest.raises(CalibrationError, match=r"3 \.\. 40 squares"):
        Board(2, 2, 0.024)


@needs_charuco
def test_the_whole_way_by_command(
    tmp_path: Path, pictures: list[np.ndarray], camera: BoardCamera, capsys: pytest.CaptureFixture[str]
) -> None:
    shots, laid = tmp_path / "shots", tmp_path / "laid"
    shots.mkdir()
    laid.mkdir()
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(shots / f"{number:02d}.png"), picture)
    cv2.imwrite(str(laid / "0.png"), camera.picture(*camera.centred(np.array([0.1, 0.05, 0.0]), (480, 270), 0.5)))
    out = tmp_path / "camera.yaml"
    calibrate_camera.main(["lens", str(shots), "--out", str(out), "--serial", "CAM-1", "--rows", "7"])
    calibrate_camera.main(["plane", str(laid), "--calibration", str(out), "--finger", "index"])
    known = files.load(out)
    assert known.camera_serial == "CAM-1"
    assert known.views == len(pictures)
    assert known.lens.matrix[0, 0] == pytest.approx(905.0, rel=3e-3)
    cross = PlaneMap(known.lens, known.plane("index")).to_pixels(np.zeros((1, 2)))
    turn, place = camera.centred(np.array([0.1, 0.05, 0.0]), (480, 270), 0.5)
    expected = cv2.projectPoints(np.array([[*cross_origin(BOARD), 0.0]]), turn, place, TRUE.matrix, TRUE.distortion)[0]
    assert cross[0] == pytest.approx(expected.ravel(), abs=1.0)
    calibrate_camera.main(["target", "--plane", "--columns", "9", "--rows", "6", "--out", str(tmp_path / "t.pdf")])
    assert (tmp_path / "t.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(SystemExit):
        calibrate_camera.main(["lens", str(laid), "--out", str(out)])
    assert "expected at least 8 different views" in capsys.readouterr().out


def test_a_calibration_survives_its_file(tmp_path: Path) -> None:
    before = make_calibration(("index", "thumb"))
    files.save(before, tmp_path / "c.yaml")
    after = files.load(tmp_path / "c.yaml")
    assert after.lens.matrix == pytest.approx(before.lens.matrix)
    assert after.lens.distortion == pytest.approx(before.lens.distortion)
    assert after.plane("thumb").homography == pytest.approx(before.plane("thumb").homography)
    assert len(after.digest) == 16


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("schema: 1", "schema: 7"), "schema 1, found 7"),
        (("plumb_bob", "fisheye"), "distortion_model"),
        (("finger: index", "fingre: index"), "'finger' is missing"),
        (("marker_diameter_m: 0.005", "marker_diameter_m: 5.0"), "marker_diameter_m"),
        (("image_width: 1280", "image_width: 128"), "principal point"),
        (("image_width: 1280", "image_width: [1280"), "expected a camera calibration"),
    ],
)
def test_wrong_files_are_named(tmp_path: Path, change: tuple[str, str], complaint: str) -> None:
    path = tmp_path / "c.yaml"
    files.save(make_calibration(), path)
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change))
    with pytest.raises(CalibrationError, match=complaint):
        files.load(path)


def test_no_file_and_no_plane(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="No such file"):
        files.load(tmp_path / "missing.yaml")
    with pytest.raises(CalibrationError, match="expected a plane for finger 'ring', found: index"):
        make_calibration().plane("ring")


def test_plane_map_is_its_own_inverse_and_its_jacobian_a_derivative() -> None:
    known = make_calibration()
    plane = PlaneMap(known.lens, known.plane("index"))
    points = np.array([[0.0, 0.0], [0.09, -0.01], [0.03, -0.06]])
    pixels = plane.to_pixels(points)
    back, jacobian = plane.to_plane_with_jacobian(pixels)
    assert back == pytest.approx(points, abs=1e-7)
    step = np.array([0.3, -0.2])
    moved = plane.to_plane(pixels + step)
    assert moved - back == pytest.approx(jacobian @ step, abs=2e-7)


def test_an_opencv_that_knows_no_charuco_is_named_and_has_a_chessboard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "aruco", None, raising=False)
    assert not Board(11, 7, 0.024).charuco
    board = Board(11, 7, 0.024, charuco=True)
    for ask in (board.modules, lambda: board.find(np.zeros((480, 640, 3), np.uint8))):
        with pytest.raises(CalibrationError, match=r"OpenCV 4\.7 or later .*--chessboard"):
            ask()
