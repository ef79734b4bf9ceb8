"""A finger whose inside is a participating medium: the reference for subsurface scattering.

The body is a closed mesh. Part of its surface is in contact with the glass: matched in index, lit from outside by
diffuse light of irradiance 1 over those faces. The rest is open: either matched too (what arrives leaves) or a smooth
boundary to air, which reflects most of the light back inside. Computed is the exitance of the surface.

Paths are traced backwards, by Mitsuba's volumetric path tracer, in llvm or scalar variants.

References
----------
M. Nimier-David, D. Vicini, T. Zeltner and W. Jakob, "Mitsuba 2", ACM Trans. Graphics 38(6) (2019) 203; the integrator
is ``volpath`` of Mitsuba 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from evanesce.core.rng import generator
from evanesce.core.states import ContactState
from evanesce.optics.subsurface import absorption_coefficient
from evanesce.rig import Finger

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Boundary = Literal["matched", "air"]

START = 1e-3
"""Distance from the surface at which paths start [mm]; Mitsuba moves rays off surfaces by about 1e-4 (1 + |p|)."""
TOUCHING_MM = 1e-4
"""Largest gap that counts as touching."""
MAX_DEPTH = 2000
ROULETTE = 60
"""Scatterings before Russian roulette: a path of albedo 0.95 keeps 5 % of its weight until then."""


@dataclass(frozen=True)
class Silicone:
    """A medium that scatters isotropically.

    Attributes
    ----------
    extinction : float
        sigma_t = 1 / transport mean free path [1/mm].
    albedo : float
        Of a single scattering [1].
    refractive_index : float
        Counts at an open boundary to air.
    """

    extinction: float
    albedo: float
    refractive_index: float = 1.41

    @classmethod
    def of(cls, reflectance: float, length: float, refractive_index: float = 1.41) -> Silicone:
        """Return the medium of a body with a diffuse reflectance [1] and a transport mean free path [mm]."""
        absorbed = absorption_coefficient(reflectance, length) * length
        return cls(1.0 / length, 1.0 - absorbed, refractive_index)


@dataclass(frozen=True)
class Body:
    """A closed surface, and which of its faces are in contact with the glass.

    Attributes
    ----------
    mesh : trimesh.Trimesh
        Watertight, normals outwards [mm].
    touching : ndarray of bool (faces,)
    """

    mesh: trimesh.Trimesh
    touching: NDArray[np.bool_]

    def __post_init__(self) -> None:
        if not self.mesh.is_watertight:
            raise ValueError("the body's mesh is not closed")
        if self.touching.shape != (len(self.mesh.faces),):
            raise ValueError(f"{self.touching.shape} flags for {len(self.mesh.faces)} faces")


def slab_body(touching: Any, *, half: float, depth: float, cell: float, fine: float) -> Body:
    """Return a flat slab above z = 0.

    Parameters
    ----------
    touching : callable
        ``touching(x, y) -> bool`` at the middle of each face of the lower side [mm].
    half, depth : float
        Half its width, and its height [mm].
    cell : float
        Size of faces within ``fine`` of the middle, coarser beyond [mm].
    fine : float
        [mm].
    """
    import trimesh  # a third of a second that those who trace no path need not wait

    inner = np.linspace(-fine, fine, 2 * round(fine / cell) + 1)
    line = np.concatenate([[-half], inner, [half]]) if half > fine else inner
    x, y = np.meshgrid(line, line)
    n, count = line.size, line.size**2
    bottom = np.stack([x.ravel(), y.ravel(), np.zeros(count)], axis=1)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)[None, :]).ravel()
    down = np.concatenate(
        [np.stack([corner, corner + n, corner + 1], 1), np.stack([corner + 1, corner + n, corner + n + 1], 1)]
    )
    # The upper side repeats the lower, turned round, so that the sides' edges meet.
    vertices = np.concatenate([bottom, bottom + np.array([0.0, 0.0, depth])])
    rim = np.concatenate(
        [np.arange(n), np.arange(2 * n - 1, count, n), np.arange(count - 2, count - n - 1, -1),
         np.arange(count - 2 * n, 0, -n)]
    )  # fmt: skip
    after = np.roll(rim, -1)
    sides = np.concatenate([np.stack([rim, after, after + count], 1), np.stack([rim, after + count, rim + count], 1)])
    faces = np.concatenate([down, down[:, ::-1] + count, sides])
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    middle = mesh.triangles_center
    low = np.arange(len(faces)) < len(down)
    return Body(mesh, low & np.asarray(touching(middle[:, 0], middle[:, 1]), bool))


def finger_body(finger: Finger, state: ContactState, *, station: float = 0.05, sections: int = 512) -> Body:
    """Return a pressed finger, ridges included, as a closed mesh whose lower side is the state's gap.

    Parameters
    ----------
    finger : Finger
    state : ContactState
        Its gap is the height of the surface as far as its grid reaches, the sphere's beyond; where both meet, the
        larger distance from the tip decides.
    station : float
        Radial step within the grid's reach [mm].
    sections : int
        Around the axis.
    """
    import trimesh  # a third of a second that those who trace no path need not wait

    radius, half = finger.tip_radius_mm, min(finger.diameter_mm / 2, finger.tip_radius_mm)
    grid, (cx, cy) = state.grid, finger.position_mm
    reach = min(0.98 * half, min(grid.shape) * grid.pitch / 2 - 2 * grid.pitch)
    depth = float(state.depth) if np.isfinite(state.depth) else 0.0
    r = np.concatenate([np.arange(station, reach, station), np.linspace(reach, half, 5)])
    below = [(0.0, 0.0), *((float(q), float(radius - np.sqrt(max(radius**2 - q**2, 0.0)))) for q in r)]
    top = max(finger.length_mm, below[-1][1] + 1.0)
    profile = np.array([*below, (half, top), (0.0, top)])
    mesh = trimesh.creation.revolve(profile, sections=sections)
    mesh.merge_vertices()
    vertices = np.array(mesh.vertices)
    distance, lower = np.hypot(vertices[:, 0], vertices[:, 1]), vertices[:, 2] < top - 1e-9
    row, col = grid.index(vertices[:, 0] + cx, vertices[:, 1] + cy)
    gap = map_coordinates(np.asarray(state.gap, float), [row, col], order=1, mode="nearest")
    # Far out the state's gap is that of a paraboloid; the body is a sphere.
    sphere = np.maximum(vertices[:, 2] - depth, 0.0)
    blend = np.clip((distance - 0.5 * reach) / (0.45 * reach), 0.0, 1.0)
    height = np.where(lower, (1 - blend) * gap + blend * np.maximum(sphere, 0.0), vertices[:, 2])
    vertices[:, 2] = np.where(gap <= TOUCHING_MM, np.where(lower & (distance < reach), 0.0, height), height)
    vertices[:, :2] += (cx, cy)
    mesh = trimesh.Trimesh(vertices, mesh.faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    return Body(mesh, (mesh.triangles[:, :, 2] <= TOUCHING_MM).all(axis=1))


def medium_scene(body: Body, silicone: Silicone, boundary: Boundary) -> Any:
    """Return the Mitsuba scene of a body lit through its touching faces with irradiance 1 per area.

    The variant is the current one.

    Parameters
    ----------
    body : Body
    silicone : Silicone
    boundary : {"matched", "air"}
        Of the faces not in contact.

    Returns
    -------
    mitsuba.Scene
    """
    import mitsuba as mi

    from evanesce.render.reference.scene import make_mesh

    inside = mi.load_dict(
        {
            "type": "homogeneous",
            "albedo": silicone.albedo,
            "sigma_t": silicone.extinction,
            "phase": {"type": "isotropic"},
        }
    )
    vertices, faces = np.asarray(body.mesh.vertices), np.asarray(body.mesh.faces)
    shapes: dict[str, Any] = {"type": "scene"}
    lit, dark = faces[body.touching], faces[~body.touching]
    if len(lit):
        # Turned inside out, so that they shine into the body and are dark from below.
        emitter = {"type": "area", "radiance": {"type": "uniform", "value": 1.0 / np.pi}}
        shapes["touching"] = make_mesh(
            "touching", vertices, lit[:, ::-1], {"type": "null"}, emitter=emitter, exterior=inside
        )
    surface: dict[str, Any] = {"type": "null"}
    if boundary == "air":
        surface = {"type": "dielectric", "int_ior": silicone.refractive_index, "ext_ior": 1.0}
    if len(dark):
        shapes["open"] = make_mesh("open", vertices, dark, surface, interior=inside)
    return mi.load_dict(shapes, parallel=False)


def exitance(scene: Any, points: Array, *, seed: int) -> Array:
    """Return one sample each of what leaves the surface above points, over the irradiance that enters.

    Parameters
    ----------
    scene : mitsuba.Scene
        From :func:`medium_scene`.
    points : ndarray (n, 2)
        (x, y) [mm]; the surface is the first that a vertical ray from below meets.
    seed : int

    Returns
    -------
    ndarray (n,)
        Unbiased: their mean over points is the mean exitance [1]; 0 where no surface is met.
    """
    import mitsuba as mi

    # A named stream: a caller's points may come from a generator of the same seed.
    rng = generator(seed, "medium", "directions")
    normal, point, met = _surface(scene, points)
    # Cosine-weighted about the inward normal: the mean radiance times pi is the exitance.
    u, phi = rng.random(len(points)), 2 * np.pi * rng.random(len(points))
    side, up = np.sqrt(u), np.sqrt(1 - u)
    helper = np.where(np.abs(normal[:, :1]) > 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    a = np.cross(normal, helper)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(normal, a)
    direction = side[:, None] * (np.cos(phi)[:, None] * a + np.sin(phi)[:, None] * b) - up[:, None] * normal
    origin = point + START * normal
    integrator = mi.load_dict({"type": "volpath", "max_depth": MAX_DEPTH, "rr_depth": ROULETTE})
    sampler = mi.load_dict({"type": "independent"})
    if str(mi.variant()).startswith("scalar"):
        sampler.seed(seed)
        radiance = np.array(
            [_one(mi, integrator, scene, sampler, o, d) for o, d in zip(origin, direction, strict=True)]
        )
    else:
        sampler.seed(seed, len(points))
        ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f(direction.T)))
        spectrum, _, _ = integrator.sample(scene, sampler, ray)
        radiance = np.array(spectrum[0])
    return np.where(met, np.pi * radiance, 0.0)


def _one(mi: Any, integrator: Any, scene: Any, sampler: Any, origin: Array, direction: Array) -> float:
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction)))
    return float(integrator.sample(scene, sampler, ray)[0][0])


def _surface(scene: Any, points: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return outward normal, point, and whether there is a surface above each point."""
    import mitsuba as mi

    start = np.column_stack([points, np.full(len(points), -1.0)])
    if str(mi.variant()).startswith("scalar"):
        hits = [scene.ray_intersect(mi.Ray3f(mi.Point3f(*p), mi.Vector3f(0, 0, 1))) for p in start]
        normal = np.array([np.array(h.n) for h in hits]).reshape(-1, 3)
        point = np.array([np.array(h.p) for h in hits]).reshape(-1, 3)
        met = np.array([h.is_valid() for h in hits])
    else:
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(0, 0, 1)))
        normal, point = np.array(hit.n).T.astype(float), np.array(hit.p).T.astype(float)
        met = np.array(hit.is_valid())
    # The lit faces are turned round; from below, outwards is downwards.
    normal = np.where(normal[:, 2:] > 0, -normal, normal)
    normal = np.where(met[:, None], normal, [[0.0, 0.0, -1.0]])
    return normal, np.where(met[:, None], point, start), met
