"""Fields of a rig in a fifth of the time, for a search over many rigs: the finger's flank from fewer points.

Nine tenths of a new rig's fields go into the flank, which is dim and smooth; what the contact itself sends to the lens
is computed as for any other rig. The fields are kept in this process only, under the rig's own key, until
:func:`~evanesce.render.kept.forget`; the files of full fields on disk are neither read nor written.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evanesce.optics.flank.field import flank_irradiance
from evanesce.optics.plate_field import unit_fields
from evanesce.render.fast.rig_fields import (
    FLANK_DEPTHS,
    PER_EDGE,
    RigFields,
    UnitLight,
    _bins,
    _flank_surface,
    _nodes,
    compute_rig_fields,
    edge_light,
    rig_digest,
    unit_digest,
)
from evanesce.render.kept import kept
from evanesce.rig import Scene

Array = NDArray[np.float64]

AZIMUTH_STEP = 2
"""Every so many azimuths of the flank are computed; between them it is interpolated."""


def depths_needed(approaches_mm: tuple[float, ...], radius_mm: float) -> NDArray[np.intp]:
    """Return the indices of the flank's depths between which the approaches [mm] of a tip lie."""
    share = np.asarray(approaches_mm) / radius_mm
    above = np.clip(np.searchsorted(FLANK_DEPTHS, share), 1, FLANK_DEPTHS.size - 1)
    return np.unique(np.concatenate([above - 1, above]))


def sketched_unit_light(scene: Scene, depths: NDArray[np.intp]) -> UnitLight:
    """Compute the light of unit sources with a coarse flank.

    Parameters
    ----------
    scene : Scene
    depths : ndarray of int
        Indices of the flank's depths that will be asked for; the others repeat the nearest of them.
    """
    light = edge_light(scene)
    unit = unit_fields(light, _nodes(scene), _bins(scene), per_edge=PER_EDGE)
    points, normals = (a[depths][:, :, ::AZIMUTH_STEP] for a in _flank_surface(scene))
    coarse = flank_irradiance(light, points.reshape(-1, 3), normals.reshape(-1, 3), per_edge=PER_EDGE)
    flank = (_spread(table.reshape(-1, *points.shape[:-1]), depths) for table in coarse)
    found = (unit.led, unit.edge, unit.exchange.from_led, unit.exchange.from_edge, *flank)
    return UnitLight(*(np.asarray(a, np.float32) for a in found))


def _spread(table: Array, depths: NDArray[np.intp]) -> Array:
    """Return a table (sources, depths, stations, azimuths) at all depths and azimuths, flat but for the sources."""
    count = table.shape[-1] * AZIMUTH_STEP
    around = np.repeat(table, AZIMUTH_STEP, axis=-1)
    following = np.repeat(np.roll(table, -1, axis=-1), AZIMUTH_STEP, axis=-1)
    part = np.tile(np.arange(AZIMUTH_STEP) / AZIMUTH_STEP, count // AZIMUTH_STEP)
    fine = around * (1 - part) + following * part
    nearest = np.abs(np.arange(FLANK_DEPTHS.size)[:, None] - depths[None, :]).argmin(axis=1)
    return np.asarray(fine[:, nearest].reshape(table.shape[0], -1))


def sketch_fields(scene: Scene, approaches_mm: tuple[float, ...]) -> RigFields:
    """Compute a rig's fields with a coarse flank and keep them for :func:`~evanesce.render.fast.transport.render_fast`.

    Parameters
    ----------
    scene : Scene
        After effects of the rig.
    approaches_mm : tuple of float
        Approaches of the finger that will be rendered [mm].
    """
    depths = depths_needed(approaches_mm, scene.finger.tip_radius_mm)

    def unit() -> UnitLight:
        return kept("unit", f"sketch {unit_digest(scene)} {depths}", lambda: sketched_unit_light(scene, depths))

    return kept("rig", rig_digest(scene), lambda: compute_rig_fields(scene, unit()))
