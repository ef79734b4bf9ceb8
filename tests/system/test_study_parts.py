"""Estimator and budget as parts of the page: the verdict follows from the rows, not from hope."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.report.charts import maps_figure
from evanesce.studies.budget import page as budget_page
from evanesce.studies.estimator import page as estimator_page
from evanesce.studies.estimator.study import EstimatorStudy, Row
from evanesce.studies.pressure import page as pressure_page


def row(finger: str, place: str, voltage: float, refined: float, reference: float) -> Row:
    """Return a frame of 12.5 mm^2 that both measure with errors in percent."""
    return Row(
        finger=finger, place=place, force_N=1.3, voltage_V=voltage, true_mm2=12.5, reference_mm2=12.5 * (1 + reference /
        100), refined_mm2=12.5 * (1 + refined / 100), saturated_share=0.0,
    )  # fmt: skip


def test_estimators_verdict_names_the_worst_frames_and_counts_kept_goals() -> None:
    rows = [
        row("smooth", "centre", 8.0, 0.3, 3.0), row("smooth", "centre", 12.0, -0.45, 8.0),
        row("smooth", "corner", 8.0, 0.7, 4.0), row("ridged with scattering", "corner", 9.0, -1.9, 141.0),
    ]  # fmt: skip
    found = estimator_page.findings(EstimatorStudy(rows=rows, threshold=0.15, provenance={}))
    assert "at most 1.90 % (ridged with scattering, corner)" in found.verdict[0]
    assert "up to 141 % (ridged with scattering, corner)" in found.verdict[0]
    assert "2 of 3 classes" in found.verdict[1]
    assert len(found.tables[0].rows) == 3
    assert [panel.title for panel in found.charts[0].panels] == ["centre", "corner"]


def coverage(finger: str, refined: float) -> dict[str, object]:
    """Return a class of 1000 measurements."""
    return {
        "finger": finger, "place": "centre", "measurements": 1000, "frames": 9, "refined_covered": refined,
        "refined_linear_covered": refined, "reference_covered": 0.88, "refined_half_width_percent": 0.9,
        "reference_half_width_percent": 4.0, "refined_bias_percent": 0.1, "reference_bias_percent": 3.0,
        "contributions_percent": {"print": 0.2, "noise": 0.01},
        "reference_contributions_percent": {"print": 0.3, "threshold on the contact": 1.9, "noise": 0.02},
    }  # fmt: skip


@pytest.mark.parametrize(("shares", "kept"), [((0.95, 0.93), 2), ((0.929, 0.96), 1), ((0.99, 0.5), 0)])
def test_budgets_verdict_counts_classes_inside_the_wanted_share(shares: tuple[float, float], kept: int) -> None:
    found = budget_page.findings([coverage("smooth", shares[0]), coverage("ridged", shares[1])])
    assert f"{kept} of 2 classes lie within 93 to 97 %" in found.verdict[0]
    assert [line[0] for line in found.tables[1].rows] == ["print", "noise"]
    assert [line[1] for line in found.tables[2].rows] == ["0.300", "1.900", "0.020"]


def pressed(saturated: float, rms: float) -> dict[str, float | None]:
    """Return a frame of the pressure study."""
    return {
        "rms_slope": 0.3, "force_N": 1.0, "voltage_V": 9.0, "peak_MPa": 0.127, "rms_percent": rms,
        "reference_rms_percent": 31.0, "correlation": None, "reference_correlation": 0.5, "saturated_share": saturated,
        "halo_percent": 0.0, "reference_halo_percent": 7.5, "factor": 1.0,
    }  # fmt: skip


def test_pressures_verdict_keeps_saturated_frames_apart() -> None:
    found = pressure_page.findings([pressed(0.0, 2.0), pressed(0.0, 4.5), pressed(0.9, 44.0)])
    assert "2.0 to 4.5 % of its peak" in found.verdict[0]
    assert "7.5 to 7.5 % of the force" in found.verdict[1]
    assert "(1 of 3 frames)" in found.verdict[2]
    assert "44 to 44 %" in found.verdict[2]
    assert not found.maps
    assert found.tables[0].rows[0][7] == "none"


def test_error_maps_are_map_less_truth_and_hide_what_is_saturated() -> None:
    y, x = np.mgrid[:31, :43]
    true = 0.21 * np.sqrt(np.clip(1 - (x - 20.3) ** 2 / 180 - (y - 14.1) ** 2 / 120, 0, None))
    full = (true > 0.17).astype(float)
    clear, lost = (np.stack([true, 1.03 * true, 0.8 * true, hidden]) for hidden in (0 * true, full))
    rows = [pressed(0.0, 2.0), pressed(0.9, 44.0)]
    found = pressure_page.findings(rows, {"clear": clear, "lost": lost})
    assert "-20 % over the tenth" in found.maps[0].caption
    assert "grey, 90 % of the contact" in found.maps[1].caption.replace("90%", "90 %")
    for maps, hidden in zip(found.maps, (0 * full, full), strict=True):
        model, reference = maps.rows[1]
        np.testing.assert_allclose(model.values, 0.03 * true, atol=1e-15)
        np.testing.assert_allclose(reference.values, -0.2 * true, atol=1e-15)
        np.testing.assert_array_equal(reference.unknown, hidden > 0)
        # one scale for both, symmetric, that ends near the greatest error shown
        assert model.top == reference.top == pytest.approx(0.2 * true[hidden == 0].max(), rel=0.03)
        assert reference.signed
    figure = maps_figure(found.maps[1])
    shown = [axis.images[0] for axis in figure.axes if axis.images]
    assert [image.get_clim() for image in shown[3:5]] == [
        (-found.maps[1].rows[1][0].top, found.maps[1].rows[1][0].top)
    ] * 2
    assert np.count_nonzero(np.ma.getmaskarray(shown[4].get_array())) == np.count_nonzero(full)
