"""What a film says against its own measurement: focus, light, contacts, repeated frames, a dark frame that is none."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.refined.blur import Blur
from evanesce.measurement.refined.result import RefinedArea
from evanesce.measurement.warnings import Warning

FOCUS_FACTOR = 1.6
"""Ratio of the blur of the contact's edges to the board's from which the focus is another. A film of air and bent edges
of ridges widen edges by up to 1.35 in drawn labs."""

FOCUS_PX = 0.5
"""And their difference in quadrature [px]: the least that a pixel's square and a codec leave to see."""

LIGHT_STEP = 0.15
"""Relative change of the contact's light from one frame to the next that no growing contact makes."""

LIGHT_DRIFT = 0.25
"""Relative change of the contact's light over the film: more than uneven light across a contact that grows makes."""

DARKENED = 0.5
"""Share of its median to which the light beside the contact may fall in a frame."""

LARGE_PX = 2000
"""Contacts of fewer pixels do not show their light well enough."""

APART = 0.2
"""Parts of a contact belong together up to this distance, of the square root of its area; ridges are nearer."""

COLOUR_DN = 12.0
"""Median difference of colours from the camera model's from which it is another camera's or setting's [DN]: noise of
one pixel is 2 to 6."""

PART_SHARE = 0.05
"""Least share of the area of a second contact."""


@dataclass
class FilmLog:
    """Collects, frame by frame, what speaks against a measurement.

    Parameters
    ----------
    blur : Blur
        Of the calibration.
    """

    blur: Blur
    frames: int = 0
    _indices: list[int] = field(default_factory=list)
    _edges: list[float] = field(default_factory=list)
    _steps: list[float] = field(default_factory=list)
    _grounds: list[tuple[int, float]] = field(default_factory=list)
    _colours: list[float] = field(default_factory=list)
    _several: list[int] = field(default_factory=list)
    _repeated: list[int] = field(default_factory=list)
    _last: NDArray[np.uint8] | NDArray[np.uint16] | None = None

    def add(self, index: int, image: NDArray[np.uint8] | NDArray[np.uint16], found: RefinedArea) -> None:
        """Add a frame.

        Parameters
        ----------
        index : int
        image : ndarray of uint8, (rows, cols) or (rows, cols, 3), or of uint16 (rows, cols)
            As taken [DN].
        found : RefinedArea
            Of that frame.
        """
        self.frames += 1
        if self._last is not None and np.array_equal(self._last, image):
            self._repeated.append(index)
        self._last = image
        self._grounds.append((index, found.ground))
        if found.mask.sum() < LARGE_PX:
            return
        if parts(found.mask) > 1:
            self._several.append(index)
        if found.unseen or found.scattering.length_px:  # light and edges are a model's there
            return
        self._indices.append(index)
        self._steps.append(found.step)
        if found.edge_px is not None:
            self._edges.append(found.edge_px)
        if found.colour_misfit_DN is not None:
            self._colours.append(found.colour_misfit_DN)

    def warnings(self) -> list[Warning]:
        """Return the warnings about the frames so far.

        Returns
        -------
        list of Warning
        """
        found = [*self._focus(), *self._light()]
        if self._colours and np.median(self._colours) > COLOUR_DN:
            text = (
                f"the contact's colours differ by {np.median(self._colours):.0f} DN from the camera model's at any"
                " level: another camera's, or other settings? areas may be wrong"
            )
            found.append(Warning("camera_model_at_odds", text))
        if self._several:
            text = (
                f"{self._of(self._several)} show contact in parts that lie apart, which are counted together: a second"
                " finger, or light that is no contact? --crop measures one of them"
            )
            found.append(Warning("several_contacts", text))
        if self._repeated:
            text = (
                f"{self._of(self._repeated)} equal the frame before: the recorder repeated them, times are not theirs"
            )
            found.append(Warning("repeated_frames", text))
        return found

    def _of(self, indices: list[int]) -> str:
        return f"{len(indices)} of {self.frames} frame(s), first {indices[0]},"

    def _focus(self) -> list[Warning]:
        if not self._edges or self.blur.origin == "nominal":
            return []
        seen, board = float(np.median(self._edges)), self.blur.px
        more, less = max(seen, board), min(seen, board)
        if more < FOCUS_FACTOR * less or math.sqrt(more**2 - less**2) < FOCUS_PX:
            return []
        text = (
            f"the contact's edges are blurred by {seen:.2f} px, the calibration by {board:.2f} px: is the lens focused"
            " as it was? its scale changes with the focus"
        )
        return [Warning("focus_changed", text)]

    def _light(self) -> list[Warning]:
        steps = np.array(self._steps)
        if len(steps) > 1:
            change = np.abs(np.diff(np.log(np.maximum(steps, 1e-9))))
            many = int((change > LIGHT_STEP).sum())
            if many:
                k = int(change.argmax())
                text = (
                    f"the contact's light changes by more than {100 * LIGHT_STEP:.0f} % between {many} pair(s) of"
                    f" frames, by a factor of {steps[k + 1] / steps[k]:.2f} at frame {self._indices[k + 1]}: flicker?"
                )
                return [Warning("light_changes", text)]
            tenth = len(steps) // 10 + 1
            drift = float(np.median(steps[-tenth:]) / max(float(np.median(steps[:tenth])), 1e-9))
            if abs(math.log(max(drift, 1e-9))) > LIGHT_DRIFT:
                text = (
                    f"the contact's light drifts by a factor of {drift:.2f} from frame {self._indices[0]} to"
                    f" {self._indices[-1]}: LEDs that warm up, automatic exposure? a fixed threshold does not follow"
                )
                return [Warning("light_changes", text)]
        usual = float(np.median([ground for _, ground in self._grounds])) if self._grounds else 0.0
        dark = [index for index, ground in self._grounds if ground < DARKENED * usual]
        if dark and usual > 0:
            text = f"{self._of(dark)} are darker beside the contact than half the usual: LEDs off, or the lens covered?"
            return [Warning("light_changes", text)]
        return []


def parts(mask: NDArray[np.bool_]) -> int:
    """Return the number of contacts in a mask: parts farther apart than ridges are.

    Parameters
    ----------
    mask : ndarray of bool (rows, cols)

    Returns
    -------
    int
    """
    total = int(mask.sum())
    if not total:
        return 0
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = mask[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    apart = cv2.distanceTransform((~box).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    _, labels = cv2.connectedComponents((apart <= 0.5 * APART * math.sqrt(total)).astype(np.uint8))
    sizes = np.bincount(labels[box])[1:]
    return int((sizes >= PART_SHARE * total).sum())


def dark_warning(free: bool, name: str) -> Warning | None:
    """Return the warning about dark shots of a path that show contact.

    Parameters
    ----------
    free : bool
        Of :func:`~evanesce.measurement.survey.is_free`.
    name : str
        Of the path.

    Returns
    -------
    Warning or None
    """
    if free:
        return None
    return Warning(
        "dark_shows_contact",
        f"{name} shows something as large and as bright as the contact, which is taken off it: a finger on the plate?",
    )
