"""Areas, tables, the square card, warnings and pictures of a measurement, on drawn frames of known size."""

from __future__ import annotations

import csv
import dataclasses
import io
import math

import av
import cv2
import numpy as np
import pytest

from evanesce.core.errors import InputError, WorkError
from evanesce.core.states import Frame
from evanesce.measurement import plots
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import rectification, undistort_points
from evanesce.measurement.reference.area import (
    AreaRow,
    halfway_threshold,
    measure_frame,
    square_scale,
    summary,
    to_csv,
    to_plain,
)
from evanesce.measurement.reference.segment import Chain, Crop
from evanesce.measurement.warnings import FrameFigures, FrameLog, frame_rate_warning, scale_warning


def ellipse(shape=(321, 407), centre=(233.4, 141.7), axes=(97.3, 61.9), low=11, high=181, turn=0.3):
    """An ellipse drawn with 8 x 8 samples a pixel: half levels lie on its outline."""
    rows, cols = shape
    fine = (np.arange(8) + 0.5) / 8 - 0.5
    y = (np.arange(rows)[:, None] + fine).ravel()[:, None] - centre[1]
    x = (np.arange(cols)[:, None] + fine).ravel()[None, :] - centre[0]
    u, v = x * math.cos(turn) + y * math.sin(turn), -x * math.sin(turn) + y * math.cos(turn)
    inside = ((u / axes[0]) ** 2 + (v / axes[1]) ** 2 < 1).reshape(rows, 8, cols, 8).mean(axis=(1, 3))
    return np.rint(low + (high - low) * inside).astype(np.uint8)


def test_area_of_an_ellipse():
    """At the half level a blur moves a curved edge by sigma^2/(2 R), inwards: 0.5 px^2 on R of 40 to 150 px.

    Counting pixels of a smooth outline of 506 px adds a spread of about sqrt(506/12) px (each crossing uniform in a
    pixel), so the count is within 4 x 6.5 + 506 x 0.5/61.9 (bound of the shift) = 30 px of pi a b.
    """
    half = (11 + 181) / 2 / 255
    found = measure_frame(Frame(data=ellipse(), time=1.25, index=7), Chain(threshold=half), 0.0003)
    assert found.estimate.pixels == pytest.approx(math.pi * 97.3 * 61.9, abs=30)
    assert found.estimate.area == found.estimate.pixels * 0.0003
    assert (found.estimate.time, found.estimate.index) == (1.25, 7)


def test_rectified_frames_are_cropped_in_the_rectified_view():
    """An ellipse seen through barrel distortion: only after rectification does its mask have the ideal centroid."""
    matrix = np.array([[402.3, 0, 198.6], [0, 397.9, 169.2], [0, 0, 1.0]])
    calibration = Calibration(image_size=(407, 321), camera_matrix=matrix, distortion=np.array([-0.5, 0.2, 0, 0, 0]))
    rectified = rectification(calibration)
    drawn = ellipse(axes=(19.0, 13.0), centre=(303.4, 81.7))
    crop = Crop(20, 190, 250, 420)
    found = measure_frame(Frame(data=drawn), Chain(threshold=0.376, min_blob=500, crop=crop), 1.0, rectified)
    assert found.view.shape == found.estimate.mask.shape == (170, 170)
    # which ideal pixels the ellipse covers, by OpenCV's own distortion
    x0, y0 = rectified.origin
    y, x = np.mgrid[y0 + 20 : y0 + 190, x0 + 250 : x0 + 420].astype(float)
    rays = np.stack([(x - 198.6) / 402.3, (y - 169.2) / 397.9, np.ones_like(x)], axis=-1).reshape(-1, 3)
    seen, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, calibration.distortion)
    px, py = (seen.reshape(170, 170, 2) - [303.4, 81.7]).transpose(2, 0, 1)
    u, v = px * math.cos(0.3) + py * math.sin(0.3), -px * math.sin(0.3) + py * math.cos(0.3)
    inside = (u / 19) ** 2 + (v / 13) ** 2 < 1
    # blur and bilinear resampling (sigma^2 of 1 and up to 1/4 px^2) pull an outline of radius 9 px or more in by up to
    # 0.07 px; drawing in eighths of a pixel adds as much: 0.14 px along some 120 px of outline
    assert np.count_nonzero(inside ^ found.estimate.mask) <= 0.14 * 120
    ideal = undistort_points(np.array([303.4, 81.7]), matrix, calibration.distortion)
    assert np.abs(ideal - [303.4, 81.7]).max() > 5  # without rectification it would lie far off


ROWS = [AreaRow(0, 0.0, 0, 0.0, 0), AreaRow(2, 1 / 15, 10_001, 10_001 * 0.0002935, 1), AreaRow(3, math.nan, 7, 0.1, 2)]
ROWS[1] = dataclasses.replace(ROWS[1], area_low_mm2=2.9, area_high_mm2=3.01)


def test_table_reads_back_to_the_last_bit():
    read = list(csv.DictReader(io.StringIO(to_csv(ROWS))))
    assert list(read[0]) == [
        "index", "time_s", "pixels_px", "area_mm2", "blobs", "area_low_mm2", "area_high_mm2", "corrected_mm2",
        "reference_mm2",
    ]  # fmt: skip
    for line, row in zip(read, ROWS, strict=True):
        assert (int(line["index"]), int(line["pixels_px"]), int(line["blobs"])) == (row.index, row.pixels, row.blobs)
        assert float(line["area_mm2"]) == row.area_mm2
        assert (line["time_s"] == "") if math.isnan(row.time_s) else (float(line["time_s"]) == row.time_s)
    assert [line["area_high_mm2"] for line in read] == ["", "3.01", ""]
    assert to_plain(ROWS)[1] == {
        "index": 2, "time_s": 1 / 15, "pixels": 10_001, "area_mm2": 10_001 * 0.0002935, "blobs": 1,
        "area_low_mm2": 2.9, "area_high_mm2": 3.01,
    }  # fmt: skip


def test_summary():
    found = summary(ROWS[:2])
    assert found["frames"] == 2
    assert found["frames_with_contact"] == 1
    assert found["duration_s"] == 1 / 15
    assert found["area_max_index"] == 2
    assert found["area_mean_mm2"] == pytest.approx(10_001 * 0.0002935 / 2, rel=1e-14)
    with pytest.raises(ValueError, match="no frames"):
        summary([])


def card(side=163.0, turn_deg=7.0, shape=(347, 411), centre=(190.3, 171.8), low=24, high=207, stretch=1.0):
    """A filled square (stretched along its first side), with 8 x 8 samples a pixel."""
    rows, cols = shape
    fine = (np.arange(8) + 0.5) / 8 - 0.5
    y = (np.arange(rows)[:, None] + fine).ravel()[:, None] - centre[1]
    x = (np.arange(cols)[:, None] + fine).ravel()[None, :] - centre[0]
    t = math.radians(turn_deg)
    u, v = x * math.cos(t) + y * math.sin(t), -x * math.sin(t) + y * math.cos(t)
    inside = (np.abs(u) < side * stretch / 2) & (np.abs(v) < side / 2)
    return np.rint(low + (high - low) * inside.reshape(rows, 8, cols, 8).mean(axis=(1, 3))).astype(np.uint8)


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("square", ["white", "black"])
def test_square_card(square, colour):
    """15 mm over 163 px: mm^2 per pixel to the counting error of a turned outline, 4 sqrt(652/12) px in 163^2: 0.11 %.

    The blur rounds each corner by less than 1 px, which the bound does not notice.
    """
    image = card()
    image = image if square == "white" else 255 - image
    if colour:
        image = np.dstack([image, image, image])
    found = square_scale(image, 15.0, square=square)
    assert found.mm2_per_px == pytest.approx((15 / 163) ** 2, rel=1.1e-3)
    assert found.mm2_per_px == 225 / found.pixels
    assert found.rotation_deg == pytest.approx(7, abs=0.5)
    assert found.sides_px == pytest.approx((163, 163), abs=1.5)
    assert found.warnings == ()
    expected = (24 + 207) / 510 if square == "white" else 1 - (24 + 207) / 510
    assert found.threshold == pytest.approx(expected, abs=0.01)  # pixels on the outline pull the means together


def test_the_square_goes_through_the_same_chain():
    """With a threshold given, its pixels are those that a measurement of the same image counts."""
    chain = Chain(threshold=0.35, crop=Crop(40, 320, 60, 330))
    assert square_scale(card(), 15.0, chain).pixels == measure_frame(Frame(data=card()), chain, 1).estimate.pixels
    # and on the negative, at the same grey level: the two masks share the border between them
    dark = square_scale(255 - card(), 15.0, Chain(threshold=1 - 0.35, crop=chain.crop), square="black")
    assert dark.pixels == square_scale(card(), 15.0, chain).pixels


def test_a_stretched_square_warns():
    found = square_scale(card(stretch=1.05), 15.0)
    assert [w.code for w in found.warnings] == ["anisotropic_scale"]
    assert "5.0 %" in found.warnings[0].text or "4.9 %" in found.warnings[0].text or "5.1 %" in found.warnings[0].text


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.full((90, 90), 77, np.uint8), "flat"),
        (ellipse(), "no square"),
        (card(centre=(60.0, 171.8)), "border"),
        (np.hstack([card(), card()]), "2 white blobs"),
    ],
    ids=["flat", "ellipse", "cut", "two"],
)
def test_what_is_no_square_is_refused(image, message):
    with pytest.raises(InputError, match=message):
        square_scale(image, 15.0)


@pytest.mark.parametrize("side", [0, -15, math.nan, math.inf])
def test_bad_side(side):
    with pytest.raises(InputError, match="square side"):
        square_scale(card(), side)


def test_halfway_threshold_of_two_levels():
    image = np.full((50, 60), 40, np.uint8)
    image[10:30, 20:41] = 141
    assert halfway_threshold(image) == pytest.approx(181 / 510, rel=1e-12)


def figures(index, pixels=1000, saturated=0, border=0, dropped=0, levels=(0.02, 0.7)):
    return FrameFigures(index, pixels, saturated, border, dropped, levels)


def warnings_of(*frames, threshold=0.15):
    log = FrameLog(threshold)
    for frame in frames:
        log.add(frame)
    return {w.code: w.text for w in log.warnings()}


def test_a_plain_measurement_warns_of_nothing():
    assert warnings_of(figures(0), figures(1, saturated=9)) == {}  # 0.9 % of the mask is below the limit of 1 %
    assert warnings_of() == {}


def test_warnings_name_their_figures():
    found = warnings_of(
        figures(0, pixels=0, dropped=3), figures(4, saturated=37), figures(5, saturated=11), figures(6, border=41)
    )
    assert found["saturation"].startswith("saturated pixels in 2 of 4 frame(s), first 4: 3.7 % of the mask")
    assert "1 of 4 frame(s), first 0" in found["nothing_segmented"]
    assert "3 blob(s)" in found["nothing_segmented"]
    assert "41 border pixels in frame 6" in found["mask_touches_border"]
    assert "threshold_outside_histogram" not in found


def test_threshold_outside_the_histogram():
    above = warnings_of(figures(0, levels=(0.01, 0.08)), figures(1, levels=(0.02, 0.1203)))
    assert "0.0100 to 0.1203: no pixel is brighter" in above["threshold_outside_histogram"]
    below = warnings_of(figures(0, levels=(0.31, 0.5)))
    assert "every pixel is brighter" in below["threshold_outside_histogram"]


def test_figures_of_a_frame():
    """A saturated bar that leaves the crop at the left: all its pixels saturated, its first column on the border."""
    image = np.full((120, 160, 3), 9, np.uint8)
    image[50:75, :90] = [255, 100, 90]
    found = measure_frame(Frame(data=image, index=3), Chain(threshold=0.2, blur=0.0), 1.0).figures
    assert (found.index, found.pixels, found.saturated_pixels, found.border_pixels) == (3, 25 * 90, 25 * 90, 25)


def test_rates_and_scales():
    assert frame_rate_warning(29.97, 30, "x") is None
    assert frame_rate_warning(30, None, "x") is None
    assert frame_rate_warning(25, 30, "x").code == "frame_rate_at_odds"
    assert frame_rate_warning(None, None, "x").code == "frame_rate_missing"
    assert scale_warning(0.0002935, 0.0002945) is None
    assert "+281.1 %" in scale_warning(0.0002935, 0.001118413).text  # the two figures of the published scripts
    assert scale_warning(None, 1.0) is None


def test_overlay_paints_the_outline_and_nothing_else():
    view = np.full((20, 30), 50, np.uint8)
    mask = np.zeros((20, 30), bool)
    mask[5:11, 0:12] = True
    painted = plots.overlay(view, mask)
    outline = (painted == plots.CONTOUR_RGB).all(axis=2)
    assert outline.sum() == 6 * 12 - 4 * 10  # a frame one pixel wide, closed along the image's border too
    assert (outline <= mask).all()
    assert (painted[~outline] == 50).all()


def test_intensity_map_is_grey_under_the_dilated_mask():
    image = ellipse()
    found = measure_frame(Frame(data=image), Chain(threshold=0.4), 1.0)
    level = plots.intensity_map(found)
    inside = ~np.isnan(level)
    assert inside.sum() > found.estimate.pixels  # the dilated mask is wider
    np.testing.assert_array_equal(inside, found.segmentation.dilated)
    np.testing.assert_allclose(level[inside], image[inside] / 255, rtol=1e-15)


def test_figures_are_written_whole(tmp_path):
    found = measure_frame(Frame(data=ellipse(), time=0.3), Chain(threshold=0.4), 0.0003)
    made = {
        "overlay": plots.overlay_figure(found, 0.0003),
        "intensity": plots.intensity_figure(found, 0.0003),
        "histogram": plots.histogram_figure(found, 0.4, 1.0),
        "area": plots.area_figure(ROWS[:2]),
        "untimed": plots.area_figure(ROWS),
    }
    labels = {name: (f.axes[0].get_xlabel(), f.axes[0].get_ylabel()) for name, f in made.items()}
    assert labels["overlay"] == labels["intensity"] == ("x [mm]", "y [mm]")
    assert labels["area"] == ("time [s]", "contact area [mm²]")
    assert "frame index" in labels["untimed"][0]
    for name, figure in made.items():
        plots.save_figure(figure, tmp_path / f"{name}.png")
        assert cv2.imread(str(tmp_path / f"{name}.png")) is not None
    assert sorted(p.stem for p in tmp_path.iterdir()) == sorted(made)  # no temporary file is left
    with pytest.raises(WorkError, match="cannot write"):
        plots.save_figure(made["area"], tmp_path / "absent" / "x.png")


def test_overlay_video(tmp_path):
    """31 x 43 pictures: the odd row and column go, every frame and its time is there."""
    with plots.OverlayVideo(tmp_path / "x.mp4", 12.5) as video:
        for k in range(5):
            video.add(np.full((31, 43, 3), 40 * k, np.uint8))
    with av.open(str(tmp_path / "x.mp4")) as container:
        frames = [(f.time, f.to_ndarray(format="gray")) for f in container.decode(video=0)]
    assert [t for t, _ in frames] == pytest.approx([k / 12.5 for k in range(5)], abs=1e-4)
    for k, (_, picture) in enumerate(frames):
        assert picture.shape == (30, 42)
        assert picture.mean() == pytest.approx(40 * k, abs=8)  # H.264 of limited range
    assert [p.name for p in tmp_path.iterdir()] == ["x.mp4"]


def test_a_broken_off_overlay_video_leaves_nothing(tmp_path):
    def work():
        with plots.OverlayVideo(tmp_path / "x.mp4", 30) as video:
            video.add(np.zeros((16, 16, 3), np.uint8))
            raise RuntimeError("on the way")

    with pytest.raises(RuntimeError, match="on the way"):
        work()
    assert list(tmp_path.iterdir()) == []
