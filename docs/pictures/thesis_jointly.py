"""Draw every published outcome of both fingers beside the joint judgement, and the mechanisms' probabilities.

Run from the checkout: ``python docs/pictures/thesis_jointly.py ANSWER.json``, the file of ``evanesce study
thesis-jointly bundles/thesis_silskin_0 bundles/thesis_silskin_20 --json ANSWER.json``. Writes
``docs/pictures/thesis-jointly.png`` and ``docs/pictures/thesis-mechanisms.png``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from evanesce.studies.thesis_jointly.pictures import mechanism_figure, sheet

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Write both pictures."""
    result = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    sheet(result).savefig(HERE / "thesis-jointly.png", dpi=90)
    mechanism_figure(result).savefig(HERE / "thesis-mechanisms.png", dpi=110)


if __name__ == "__main__":
    main()
