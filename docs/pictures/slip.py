"""Make the pictures that README and front page begin with: ``python docs/pictures/slip.py`` (slip.webp, slip.png)."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from evanesce.studies.demo.slip import slip_animation, slip_sequence, slip_strip

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Simulate press and slide, write the animation and the still strip."""
    sequence = slip_sequence(every=2)
    (HERE / "slip.webp").write_bytes(slip_animation(sequence))
    Image.fromarray(slip_strip(sequence)).save(HERE / "slip.png", optimize=True)


if __name__ == "__main__":
    main()
