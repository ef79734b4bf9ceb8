"""What a set of mechanisms predicts of every published outcome, at many points at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from evanesce.bench.indentation import elliptic_geometry
from evanesce.materials.hyperelastic import of_material
from evanesce.materials.tables import material
from evanesce.optics.led_circuit import radiant_power
from evanesce.rig.leds import LedCircuit
from evanesce.studies.thesis_jointly import tables
from evanesce.studies.thesis_jointly.data import Row
from evanesce.studies.thesis_jointly.mechanisms import MechanismSet

Array = NDArray[Any]
Points = Mapping[str, Array]

RADIUS_MM, CYLINDER_MM = 7.5, 12.725
MOULDED_MM, DRAWN_MM = 0.04767, 0.1
LOST_LEVEL = -2.75
"""Logarithm of the nominal light at 9 V at which half the contact falls below threshold 0.15 (``reading.npz``)."""
VOLTS = np.linspace(6.0, 10.0, 161)
BINS, DIMMER = np.linspace(2.5, 3.5, 41), np.linspace(-8.0, 1.0, 181)


class Predictor:
    """Predicts rows as they count (logarithms, or figures).

    Parameters
    ----------
    rows : sequence of Row
    chosen : MechanismSet
    """

    def __init__(self, rows: Sequence[Row], chosen: MechanismSet) -> None:
        self.rows, self.chosen = tuple(rows), chosen

    def __call__(self, points: Points) -> Array:
        """Return predictions (points, rows).

        Parameters
        ----------
        points : mapping of str to ndarray (points,)
            By parameter.
        """
        own = _Fingers(points, self.chosen)
        return np.stack([own.row(row) for row in self.rows], axis=-1)


class _Fingers:
    """Both fingers at some points, a quantity for each row."""

    def __init__(self, points: Points, chosen: MechanismSet) -> None:
        self.points, self.on = points, chosen.ids
        self.zero = np.zeros(np.shape(next(iter(points.values()))))
        self._contacts: dict[tuple[str, float], tuple[Array, Array]] = {}

    def get(self, name: str, default: float = 0.0) -> Array:
        """Return a parameter's values (points,)."""
        return np.asarray(self.points[name]) if name in self.points else self.zero + default

    @property
    def bone(self) -> Array:
        """Share of the bone (points,)."""
        return self.get("bone:share") if "bone" in self.on else self.zero

    def row(self, row: Row) -> Array:
        """Return one outcome as it counts (points,)."""
        found: Array = getattr(self, f"_{row.outcome.kind}")(row)
        return found + self.zero

    def contact(self, name: str, force: float) -> tuple[Array, Array]:
        """Return logarithms of depth [mm] and true area [mm^2] on glass (points,)."""
        key = (name, force)
        if key not in self._contacts:
            self._contacts[key] = self._contact(name, force)
        return self._contacts[key]

    def _contact(self, name: str, force: float) -> tuple[Array, Array]:
        stiffness, load = self.get(f"modulus:{name}"), self.zero + force
        if "adhesion" in self.on:
            pull = 3.0 * np.pi * 1e-3 * np.exp(self.get(f"adhesion:{name}")) * RADIUS_MM
            load = force + pull + np.sqrt(2.0 * pull * force + pull**2)
        if "hertz" in self.on:
            log_modulus = np.log(4.0 * of_material(name).shear_modulus) + stiffness
            log_radius = (np.log(0.75 * load * RADIUS_MM) - log_modulus) / 3.0
            depth, area = 2.0 * log_radius - np.log(RADIUS_MM), 2.0 * log_radius + np.log(np.pi)
        else:
            depth, area = tables.solved_press(name, self.bone, np.log(load) - stiffness)
        # JKR: the depth of Hertz's contact under the apparent load, less what adhesion pulls the edge out by.
        return depth + np.log((1.0 + 2.0 * force / load) / 3.0), area

    def level(self, name: str) -> Array:
        """Return the logarithm of light over threshold (points,)."""
        own = self.get(f"threshold:{name}") if "threshold" in self.on else self.zero
        return self.get("@light") + own

    def scattering(self, name: str) -> tuple[Array, Array]:
        """Return share and length [mm] of a finger (points,)."""
        own = f"scatter_{name.rpartition('_')[2]}"
        prefix = "scatter" if "scatter_alike" in self.on else own
        if prefix == own and not {own, "scatter_each"} & self.on:
            return self.zero, self.zero
        return self.get(f"{prefix}:share"), self.get(f"{prefix}:length_mm")

    def read(self, name: str, force: float, more_light: float = 0.0) -> Array:
        """Return the logarithm of the area that the rig reads [mm^2] (points,)."""
        area = self.contact(name, force)[1]
        scale = self.get("scale:area") if "scale" in self.on else self.zero
        reading = tables.log_read_over_true(area, *self.scattering(name), self.level(name) + more_light)
        return area + reading + scale

    def _read_area(self, row: Row) -> Array:
        return self.read(row.material, _force(row))

    def _depth(self, row: Row) -> Array:
        return self.contact(row.material, _force(row))[0]

    def _cylinder_depth(self, row: Row) -> Array:
        """Carry over what the finger's press on glass is off from Hertz's: bone and strain act alike."""
        force = _force(row)
        flat = (0.75 * force / np.sqrt(RADIUS_MM)) ** (2.0 / 3.0)
        across = float(elliptic_geometry(RADIUS_MM, CYLINDER_MM).depth(force, 1.0))
        return self._depth(row) + np.log(across / flat)

    def _youngs_modulus(self, row: Row) -> Array:
        return np.log(3.0 * of_material(row.material).shear_modulus) + self.get(f"modulus:{row.material}")

    def _friction(self, row: Row) -> Array:
        force, law = _force(row), material(row.material).friction
        assert law is not None  # both materials have one in the tables
        by_read = "friction_by_read_area" in self.on
        area = self.read(row.material, force) if by_read else self.contact(row.material, force)[1]
        return np.log(law.tau0_MPa * np.exp(area) / force + law.alpha)

    def _tilt_friction(self, row: Row) -> Array:
        return self.zero  # a sphere's contact does not know its tilt

    def _ridged_over_smooth(self, row: Row) -> Array:
        height = DRAWN_MM if "ridges_as_drawn" in self.on else MOULDED_MM
        return tables.log_ridged_over_smooth(self.zero + height, np.exp(self.get("@pitch")))

    def _overshoot(self, row: Row) -> Array:
        assert row.outcome.at.friction is not None  # checked by Outcome
        return tables.overshoot(row.outcome.at.friction, self.bone)

    def _length_change(self, row: Row) -> Array:
        return tables.shape_change("standard", "short", self.bone)

    def _diameter_change(self, row: Row) -> Array:
        return tables.shape_change("stout", "short", self.bone)

    def _bone_change(self, row: Row) -> Array:
        return tables.bone_change(self.bone)

    def _lost_below(self, row: Row) -> Array:
        """Return the voltage at which the contact's light has fallen to where it is lost [V]."""
        wanted = LOST_LEVEL - self.level(row.material)
        return _voltage(self.get("@forward_voltage", 2.95), wanted)

    def _growth(self, row: Row) -> Array:
        """Return the relative growth of the read area from 9 to 12 V."""
        if "exposure_control" in self.on:
            return self.zero
        force = row.outcome.at.force_N or 1.0
        more = _power(2.95, 12.0) - _power(2.95, 9.0)
        return np.expm1(self.read(row.material, force, more) - self.read(row.material, force))


def _force(row: Row) -> float:
    assert row.outcome.at.force_N is not None  # checked by Outcome
    return row.outcome.at.force_N


def _power(forward: float, volts: Any) -> Any:
    """Return the logarithm of an LED's power at supply voltages."""
    with np.errstate(divide="ignore"):
        return np.log(np.maximum(radiant_power(LedCircuit(forward_voltage_V=forward), volts), 1e-30))


@lru_cache(maxsize=1)
def _voltages() -> RegularGridInterpolator:
    """Return supply voltages [V] by forward voltage [V] and logarithm of the light over that at 9 V."""
    table = []
    for forward in BINS:
        curve = _power(float(forward), VOLTS) - _power(float(forward), 9.0)
        table.append(np.interp(DIMMER, curve, VOLTS))
    return RegularGridInterpolator((BINS, DIMMER), np.array(table))


def _voltage(forward: Array, wanted: Array) -> Array:
    """Return the supply voltage [V] at which light is ``exp(wanted)`` of that at 9 V, by forward voltage [V]."""
    ends = np.clip(wanted, DIMMER[0], DIMMER[-1])
    return np.asarray(_voltages()(np.stack(np.broadcast_arrays(forward, ends), axis=-1)))
