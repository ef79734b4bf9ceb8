"""Frames that the challenge keeps for the truth's gain are those that the critic holds back."""

from __future__ import annotations

import pytest

from challenge.rig import BELIEVED, believed, views
from evanesce.bundle.protocol import default_protocol
from evanesce.prediction.observe import locked_conditions


@pytest.mark.parametrize("name", sorted(BELIEVED))
def test_what_the_challenge_spares_is_what_the_critic_locks(name: str) -> None:
    """Two rules, written apart, because who hides causes may not import who looks for them."""
    locked = locked_conditions(default_protocol(believed(name)).press)
    spare = {view.shot.condition for view in views(name) if view.spare}
    assert len(locked) >= 2
    assert spare == locked
