"""What a set of mechanisms predicts of every published outcome, at many points at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
        own = Fingers(points, self.chosen, self.rows)
        return np.stack([own.row(row) for row in self.rows], axis=-1)


class Fingers:
    """Both fingers at some points, a quantity for each row."""

    def __init__(self, points: Points, chosen: MechanismSet, rows: Sequence[Row] = ()) -> None:
        self.points, self.chosen, self.on = points, chosen, chosen.ids
        self.zero = np.zeros(np.shape(next(iter(points.values()))))
        self._known: dict[tuple[str, str], Array] = {}
        self.forces = {name: _forces(rows, name) for name in ("silskin_0", "silskin_20")}

    def with_rows(self, rows: Sequence[Row]) -> Fingers:
        """Return the same fingers for other rows."""
        return Fingers(self.points, self.chosen, rows)

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

    def at(self, what: str, row: Row) -> Array:
        """Return ``depth``, true ``area`` or ``read`` area of a row's finger at its force, logarithms (points,)."""
        name = row.material
        if (what, name) not in self._known:
            if what == "read":
                self._known[what, name] = self.read(name, self.at_all("area", name))
            else:
                self._known["depth", name], self._known["area", name] = self._contact(name)
        return np.asarray(self._known[what, name][:, self.forces[name].index(_force(row))])

    def at_all(self, what: str, name: str) -> Array:
        """Return ``depth`` or true ``area`` of a finger at all its forces, logarithms (points, forces)."""
        if (what, name) not in self._known:
            self._known["depth", name], self._known["area", name] = self._contact(name)
        return self._known[what, name]

    def _contact(self, name: str) -> tuple[Array, Array]:
        """Return logarithms of depth [mm] and true area [mm^2] on glass at all forces (points, forces)."""
        force = np.array(self.forces[name])
        stiffness, load = self.get(f"modulus:{name}")[:, None], self.zero[:, None] + force
        if "adhesion" in self.on:
            pull = 3.0 * np.pi * 1e-3 * np.exp(self.get(f"adhesion:{name}")[:, None]) * RADIUS_MM
            load = force + pull + np.sqrt(2.0 * pull * force + pull**2)
        if "hertz" in self.on:
            log_modulus = np.log(4.0 * _shear_modulus(name)) + stiffness
            log_radius = (np.log(0.75 * load * RADIUS_MM) - log_modulus) / 3.0
            depth, area = 2.0 * log_radius - np.log(RADIUS_MM), 2.0 * log_radius + np.log(np.pi)
        else:
            depth, area = tables.solved_press(name, self.bone[:, None], np.log(load) - stiffness)
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

    def read(self, name: str, area: Array, more_light: float = 0.0) -> Array:
        """Return the logarithm of the area [mm^2] that the rig reads of a true one (points, forces)."""
        scale = self.get("scale:area") if "scale" in self.on else self.zero
        share, length = self.scattering(name)
        light = self.level(name) + more_light
        reading = tables.log_read_over_true(area, share[:, None], length[:, None], light[:, None])
        return area + reading + scale[:, None]

    def _read_area(self, row: Row) -> Array:
        return self.at("read", row)

    def _depth(self, row: Row) -> Array:
        return self.at("depth", row)

    def _cylinder_depth(self, row: Row) -> Array:
        """Carry over what the finger's press on glass is off from Hertz's: bone and strain act alike."""
        return self._depth(row) + _log_across_over_flat()

    def _youngs_modulus(self, row: Row) -> Array:
        return np.log(3.0 * _shear_modulus(row.material)) + self.get(f"modulus:{row.material}")

    def _friction(self, row: Row) -> Array:
        force, law = _force(row), material(row.material).friction
        assert law is not None  # both materials have one in the tables
        area = self.at("read" if "friction_by_read_area" in self.on else "area", row)
        return np.log(law.tau0_MPa * np.exp(area) / force + law.alpha)

    def _tilt_friction(self, row: Row) -> Array:
        """Return friction at 45 deg over that at 0, less 1, at 1 N: by the area of tau0 A/N + alpha."""
        law = material(row.material).friction
        assert law is not None  # both materials have one in the tables
        upright = law.static_coefficient_smooth
        return (1.0 - law.alpha / upright) * np.expm1(tables.tilted_area(row.material)(self.bone))

    @property
    def elements(self) -> tuple[Array, Array]:
        """Height and pitch of the ridges of the thesis's finite elements [mm] (points,)."""
        height = DRAWN_MM if "ridges_as_drawn" in self.on else MOULDED_MM
        return self.zero + height, np.exp(self.get("@pitch"))

    def _ridged_over_smooth(self, row: Row) -> Array:
        return np.log(tables.ridged_over_smooth(*self.elements))

    def _ridged_depth(self, row: Row) -> Array:
        return tables.ridged_deeper(*self.elements)

    def _ridged_friction(self, row: Row) -> Array:
        """Return ridged over smooth friction: that of the moulded ridges' true area, by what smooth friction leaves."""
        ratio = tables.ridged_over_smooth(self.zero + MOULDED_MM, np.exp(self.get("@pitch")))
        sticking, law = np.exp(self._friction(row)), material(row.material).friction
        assert law is not None  # both materials have one in the tables
        return np.log(ratio + (1.0 - ratio) * law.alpha / sticking)

    def _fe_area(self, row: Row) -> Array:
        """Return the area of the thesis's own finite elements: of table 6, whatever the finger is."""
        return tables.solved_press(row.material, self.bone, np.log(self.zero + _force(row)))[1]

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
        brighter = self.read(row.material, self.at("area", row)[:, None], _log_light_9_to_12V())[:, 0]
        return np.expm1(brighter - self.at("read", row))


def _forces(rows: Sequence[Row], name: str) -> list[float]:
    """Return the forces at which a finger's contact is asked for [N]."""
    own = [r.outcome.at.force_N for r in rows if r.material == name and r.outcome.at.force_N is not None]
    return list(dict.fromkeys(own))


@lru_cache(maxsize=4)
def _shear_modulus(name: str) -> float:
    return float(of_material(name).shear_modulus)


@lru_cache(maxsize=1)
def _log_across_over_flat() -> float:
    """Return the logarithm of Hertz's depth under the cylinder over that on glass, the same at every force."""
    across = float(elliptic_geometry(RADIUS_MM, CYLINDER_MM).depth(1.0, 1.0))
    return float(np.log(across / (0.75 / np.sqrt(RADIUS_MM)) ** (2.0 / 3.0)))


@lru_cache(maxsize=1)
def _log_light_9_to_12V() -> float:
    return float(_power(2.95, 12.0) - _power(2.95, 9.0))


def _force(row: Row) -> float:
    assert row.outcome.at.force_N is not None  # checked by Outcome
    return row.outcome.at.force_N


def _power(forward: float, volts: Any) -> Any:
    """Return the logarithm of an LED's power at supply voltages."""
    with np.errstate(divide="ignore"):
        return np.log(np.maximum(radiant_power(LedCircuit(forward_voltage_V=forward), volts), 1e-30))


@lru_cache(maxsize=1)
def _voltages() -> tables.Grid:
    """Return supply voltages [V] by forward voltage [V] and logarithm of the light over that at 9 V."""
    table = []
    for forward in BINS:
        curve = _power(float(forward), VOLTS) - _power(float(forward), 9.0)
        table.append(np.interp(DIMMER, curve, VOLTS))
    return tables.Grid((BINS, DIMMER), np.array(table))


def _voltage(forward: Array, wanted: Array) -> Array:
    """Return the supply voltage [V] at which light is ``exp(wanted)`` of that at 9 V, by forward voltage [V]."""
    return _voltages()(forward, wanted)
