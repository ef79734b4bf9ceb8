"""A second set of forms of the hidden causes: recipes on the pixels of a view, each from a paper or a textbook.

They share no line with ``families_*.py``, and differ from those in kind where the cause leaves room for it; where it is
geometry alone (a card's height, a square's size) they differ by what comes with it.
"""

from __future__ import annotations

from .camera import CAMERA
from .contact import CONTACT
from .light import LIGHT

RECIPES = {cause.id: cause for cause in (*CAMERA, *LIGHT, *CONTACT)}

__all__ = ["RECIPES"]
