"""The two printed calibration cards, as they really are; their nominal size stands with a lab's measurement."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field


class Cards(Strict):
    """Checkerboard and plain square of one print; each lies on the plate with its printed side down."""

    square_side_mm: float = field(15.0, unit="mm", bounds=(0.5, 500.0), source="thesis, chapter 5", doc="as printed")
    square_margin_mm: float = field(5.0, unit="mm", bounds=(0.0, 500.0), doc="frame around the square")
    square_inverted: bool = False
    checkerboard_squares: tuple[int, int] = field((42, 31), unit="1", bounds=(2, 1000), doc="columns and rows")
    checkerboard_inverted: bool = False
    checkerboard_side_mm: float = field(
        1.0, unit="mm", bounds=(0.05, 100.0), source="thesis, chapter 5", doc="side of one square, as printed"
    )
    checkerboard_margin_mm: float = field(5.0, unit="mm", bounds=(0.0, 500.0), doc="blank border around the print")
    height_mm: float = field(
        0.05, unit="mm", bounds=(0.001, 50.0), doc="printed side over the contact plane; no less than paper's air film"
    )
    white_reflectance: float = field(0.8, unit="1", bounds=(0.0, 1.0), doc="diffuse, of the paper")
    black_reflectance: float = field(0.05, unit="1", bounds=(0.0, 1.0), doc="diffuse, of the ink")
