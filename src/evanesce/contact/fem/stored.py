"""A solved press or slide as the library stores it, and its footprint between the stored steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.state import AxisymmetricProfile, gap_at, pressure_at
from evanesce.contact.fem.surface import Footprint
from evanesce.core.errors import InputError

Floats = NDArray[np.float64]
Arrays = Mapping[str, NDArray[Any]]

PRESS_FIELDS = ("r", "gap", "pressure", "traction", "slip", "slipping")
SLIDE_FIELDS = ("place", "traction", "slip", "pressure", "gap", "opening")


@dataclass(frozen=True)
class LibraryPress:
    """A press as the library keeps it.

    Attributes
    ----------
    force, depth, contact_radius : ndarray (f,)
        [N], [mm], [mm]; forces rise.
    profiles : mapping of ndarray (f, k)
        See :class:`~evanesce.contact.fem.state.AxisymmetricProfile`.
    inputs : mapping
        Of the run.
    digest : str
    """

    force: Floats
    depth: Floats
    contact_radius: Floats
    profiles: Arrays
    inputs: Mapping[str, Any]
    digest: str

    def area(self, force: float) -> float:
        """Return the area of contact [mm^2] at a force [N] between the first and the last one kept.

        Parameters
        ----------
        force : float
            [N].

        Returns
        -------
        float
            [mm^2].
        """
        return float(np.pi * self.at(force).contact_radius ** 2)

    def at(self, force: float) -> AxisymmetricProfile:
        """Return the profile at a force.

        Between two stored forces the radius of contact and the depth are interpolated in logs, and the shapes of
        pressure (over the mean pressure), gap and slip in log force at corresponding radii.

        Parameters
        ----------
        force : float
            [N].

        Returns
        -------
        AxisymmetricProfile

        Raises
        ------
        InputError
            For a force outside the library.
        """
        low, high = float(self.force[0]), float(self.force[-1])
        if not low * (1 - 1e-9) <= force <= high * (1 + 1e-9):
            raise InputError(f"{force:g} N", key="force", allowed=f"{low:g} to {high:g} N in the library")
        index = int(np.clip(np.searchsorted(self.force, force) - 1, 0, self.force.size - 2))
        share = float(
            np.clip(np.log(force / self.force[index]) / np.log(self.force[index + 1] / self.force[index]), 0, 1)
        )

        def mix(a: Any, b: Any) -> Any:
            return (1 - share) * a + share * b

        radius = float(np.exp(mix(*np.log(self.contact_radius[index : index + 2]))))
        mean = force / (np.pi * radius**2)
        # nodes stretched so that both profiles have the wanted radius of contact, then mixed node by node
        pair = [self._scaled(index + i, radius) for i in (0, 1)]
        r = mix(pair[0]["r"], pair[1]["r"])
        mixed = {key: mix(pair[0][key], pair[1][key]) for key in ("gap", "pressure", "traction", "slip")}
        return AxisymmetricProfile(
            r=r,
            gap=np.where(r > radius, np.maximum(mixed["gap"], 1e-12), 0.0),
            pressure=np.where(r < radius, mean * mixed["pressure"], 0.0),
            traction=np.where(r < radius, mean * mixed["traction"], 0.0),
            slip=np.where(r < radius, mixed["slip"], 0.0),
            slipping=pair[round(share)]["slipping"] & (r < radius),
            contact_radius=radius,
            depth=float(np.exp(mix(*np.log(self.depth[index : index + 2])))),
            normal_force=float(force),
        )

    def _scaled(self, index: int, radius: float) -> dict[str, Any]:
        """Return one stored force's fields at radii common to all; stresses in units of the mean pressure."""
        stored = {key: np.asarray(values[index], dtype=float) for key, values in self.profiles.items()}
        a, r = float(self.contact_radius[index]), stored["r"]
        widest = int(np.argmax(r)) + 1
        # radii count relative to the edge inside contact, by their distance from the edge outside
        nodes = np.linspace(0.0, 1.0, 121)
        inner, outer = nodes * a, a + nodes[1:] ** 2 * (r[widest - 1] - a)
        own = np.concatenate([inner, outer])
        profile = self._profile(index)
        mean = float(self.force[index]) / (np.pi * a**2)
        return {
            "r": np.concatenate([nodes * radius, radius + (outer - a)]),
            "gap": gap_at(profile, own, float(stored["gap"][widest - 1])),
            "pressure": pressure_at(profile, own) / mean,
            "traction": np.interp(own, r[:widest], stored["traction"][:widest]) / mean,
            "slip": np.interp(own, r[:widest], stored["slip"][:widest]),
            "slipping": np.interp(own, r[:widest], stored["slipping"][:widest]) >= 0.5,
        }

    def _profile(self, index: int) -> AxisymmetricProfile:
        fields = {key: np.asarray(values[index]) for key, values in self.profiles.items()}
        return AxisymmetricProfile(
            **{key: fields[key].astype(bool if key == "slipping" else float) for key in PRESS_FIELDS},
            contact_radius=float(self.contact_radius[index]),
            depth=float(self.depth[index]),
            normal_force=float(self.force[index]),
        )


@dataclass(frozen=True)
class LibrarySlide:
    """A slide as the library keeps it.

    Attributes
    ----------
    scalars : mapping of ndarray (s,)
        ``depth``, ``slide`` [mm], ``normal_force``, ``tangential_force`` [N], ``area`` [mm^2] by step.
    fields : mapping of ndarray (s, k) or (s, k, 2)
        Named in :mod:`evanesce.contact.fem.library`.
    inputs : mapping
        Of the run.
    digest : str
    """

    scalars: Mapping[str, Floats]
    fields: Arrays
    inputs: Mapping[str, Any]
    digest: str

    def scalar(self, name: str, slide: float) -> float:
        """Return depth [mm], a force [N] or the area [mm^2] at a slide [mm].

        Parameters
        ----------
        name : str
            Of ``scalars``.
        slide : float
            [mm].

        Returns
        -------
        float
        """
        index, share = self._between(slide)
        values = self.scalars[name]
        return float((1 - share) * values[index] + share * values[index + 1])

    def footprint(self, slide: float) -> Footprint:
        """Return the footprint at a slide; between steps node by node, in contact where the opening is negative.

        Parameters
        ----------
        slide : float
            [mm].

        Returns
        -------
        Footprint

        Raises
        ------
        InputError
            For a slide outside the library.
        """
        index, share = self._between(slide)
        mixed = {
            key: (1 - share) * self.fields[key][index].astype(float) + share * self.fields[key][index + 1].astype(float)
            for key in SLIDE_FIELDS
        }
        touching = mixed["opening"] < 0
        slipping = self.fields["slipping"][index + round(share)].astype(bool) & touching
        return Footprint(
            place=mixed["place"],
            pressure=np.where(touching, mixed["pressure"], 0.0),
            traction=np.where(touching[:, None], mixed["traction"], 0.0),
            gap=np.where(touching, 0.0, mixed["gap"]),
            touching=touching,
            slipping=slipping,
            slip=np.where(touching[:, None], mixed["slip"], 0.0),
            opening=mixed["opening"],
            area=self.scalar("area", slide),
        )

    def _between(self, slide: float) -> tuple[int, float]:
        """Return the step before a slide [mm] and the share of the distance to the next."""
        slides = self.scalars["slide"]
        if not slides[0] - 1e-9 <= slide <= slides[-1] + 1e-9:
            raise InputError(f"{slide:g} mm", key="slide", allowed=f"{slides[0]:g} to {slides[-1]:g} mm in the library")
        index = int(np.clip(np.searchsorted(slides, slide) - 1, 0, slides.size - 2))
        return index, float(np.clip((slide - slides[index]) / (slides[index + 1] - slides[index]), 0.0, 1.0))
