"""Why the reference segmentation and the refined estimator differ on a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

from skimage.measure import perimeter_crofton

from evanesce.measurement.levels import EdgeLevels
from evanesce.measurement.reference.area import Measured
from evanesce.measurement.reference.segment import Chain, Crop, segment


@dataclass(frozen=True, kw_only=True)
class Apart:
    """Difference of the reference segmentation's area from the refined one, in percent of the latter.

    Attributes
    ----------
    index : int
        Of the frame.
    reference_mm2, refined_mm2 : float
    blur_percent, flank_percent, rest_percent : float
        By the edge's blur at the threshold; by light beside the contact above it; scale, counting and the rest.
    share : float
        How far the threshold stands on the way from ground to contact, in linear light.
    """

    index: int
    reference_mm2: float
    refined_mm2: float
    blur_percent: float
    flank_percent: float
    rest_percent: float
    share: float

    def text(self, threshold: float, levels: EdgeLevels) -> str:
        """Return it as one line."""
        total = 100.0 * (self.reference_mm2 / self.refined_mm2 - 1.0)
        return (
            f"frame {self.index}: the reference segmentation counts {self.reference_mm2:.3f} mm², the refined "
            f"estimator {self.refined_mm2:.3f} ({total:+.1f} %): threshold {threshold:.3g} stands "
            f"{100 * self.share:.0f} % of the way from ground to contact, half-way is {levels.half:.3f}: "
            f"{self.blur_percent:+.1f} % by blur at the threshold, {self.flank_percent:+.1f} % by light beside the "
            f"contact, {self.rest_percent:+.1f} % by scale and counting"
        )


def apart(measured: Measured, chain: Chain, mm2_per_px: float, refined_mm2: float, levels: EdgeLevels) -> Apart | None:
    """Split the difference of both estimators on one frame.

    The same segmentation at the half-way threshold gives what the threshold does; a Gaussian edge of the frame's own
    width what of that is blur.

    Parameters
    ----------
    measured : Measured
        By the reference segmentation.
    chain : Chain
        By which it was measured.
    mm2_per_px : float
        [mm^2].
    refined_mm2 : float
        Refined area of the same frame [mm^2].
    levels : EdgeLevels
        Of the measured view.

    Returns
    -------
    Apart, or None
        None where either finds nothing.
    """
    if not (refined_mm2 > 0 and measured.segmentation.pixels):
        return None
    half = segment(measured.view, replace(chain, threshold=levels.half, crop=Crop()))
    perimeter = float(perimeter_crofton(half.mask, 4)) if half.pixels else 0.0
    unit = 100.0 * mm2_per_px / refined_mm2
    blur = unit * perimeter * levels.blurred_out_px(chain.threshold, chain.blur)
    moved = unit * (measured.segmentation.pixels - half.pixels)
    return Apart(
        index=measured.estimate.index, reference_mm2=measured.estimate.area, refined_mm2=refined_mm2,
        blur_percent=blur, flank_percent=moved - blur, rest_percent=unit * half.pixels - 100.0,
        share=levels.share(chain.threshold),
    )  # fmt: skip
