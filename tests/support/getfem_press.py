"""Press of an axisymmetric finger by GetFEM, run by the system's Python (Debian package python3-getfem).

``python3 getfem_press.py IN.npz OUT.json``: IN holds points (n, 2) as (r, z) [mm], cells (m, 4) counter-clockwise, the
nodes ``clamped`` and ``cap`` (from the apex outwards), ``tip_radius`` [mm], ``coefficients`` (c10, c01, c11, bulk)
[MPa], ``penalty`` [MPa/mm] and ``depths`` [mm]. OUT has, for each depth, the force [N] and the radius of contact [mm].

Nothing of evanesce is used: biquadratic elements with a curved tip, biquadratic displacements with a bilinear pressure,
the energy differentiated by GetFEM's form language, contact without friction as a penalty at quadrature points.
"""

import json
import sys

import getfem as gf
import numpy as np

TURN = "2*pi*X(1)"
HELD, CAP, AXIS = 1, 2, 3


def energy(c10, c01, c11):
    """Return volume ratio and distortional energy as forms; the hoop stretch is 1 + u_r/r."""
    gradient = "[[1+Grad_u(1,1),Grad_u(1,2),0],[Grad_u(2,1),1+Grad_u(2,2),0],[0,0,1+u(1)/X(1)]]"
    right = f"(({gradient})'*({gradient}))"
    volume = f"Det({gradient})"
    first = f"(pow({volume},-2/3)*Trace({right})-3)"
    second = f"(pow({volume},-4/3)*0.5*(sqr(Trace({right}))-Trace({right}*{right}))-3)"
    return volume, f"({c10})*{first}+({c01})*{second}+({c11})*{first}*{second}"


def curved_mesh(data):
    """Return a mesh of 9-node quadrilaterals whose edges on the cap follow the sphere."""
    points, cap, radius = data["points"], set(data["cap"].tolist()), float(data["tip_radius"])
    mesh = gf.Mesh("empty", 2)
    kind = gf.GeoTrans("GT_QK(2,2)")

    def middle(i, j):
        half = 0.5 * (points[i] + points[j])
        if i in cap and j in cap:
            way = half - (0.0, radius)
            half = (0.0, radius) + way * radius / np.linalg.norm(way)
        return half

    for a, b, c, d in data["cells"].tolist():
        ab, bc, cd, da = middle(a, b), middle(b, c), middle(c, d), middle(d, a)
        centre = 0.5 * (ab + bc + cd + da) - 0.25 * (points[a] + points[b] + points[c] + points[d])
        nine = [points[a], ab, points[b], da, centre, bc, points[d], cd, points[c]]
        mesh.add_convex(kind, np.array(nine).T)
    places = mesh.pts()
    index = {tuple(np.round(p, 8)): i for i, p in enumerate(places.T)}
    corners = {key: {index[tuple(np.round(points[i], 8))] for i in data[key]} for key in ("clamped", "cap")}
    corners["axis"] = {i for i, p in enumerate(places.T) if abs(p[0]) < 1e-9}
    outer = mesh.outer_faces()
    for region, key in ((HELD, "clamped"), (CAP, "cap"), (AXIS, "axis")):
        # two corners of a face in the set: an edge between them lies in it (no edge crosses from skin to skin)
        chosen = [
            k for k in range(outer.shape[1])
            if len(set(mesh.pid_in_faces(outer[:, [k]]).ravel().tolist()) & corners[key]) >= 2
        ]  # fmt: skip
        mesh.set_region(region, outer[:, chosen])
    return mesh


def build(data):
    """Return the model, its integration and the field of displacements."""
    mesh = curved_mesh(data)
    field, pressure = gf.MeshFem(mesh, 2), gf.MeshFem(mesh, 1)
    field.set_fem(gf.Fem("FEM_QK(2,2)"))
    pressure.set_fem(gf.Fem("FEM_QK(2,1)"))
    rule = gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(2,5)"))
    model = gf.Model("real")
    model.add_fem_variable("u", field)
    model.add_fem_variable("p", pressure)
    c10, c01, c11, bulk = (float(x) for x in data["coefficients"])
    volume, distortion = energy(c10, c01, c11)
    model.add_nonlinear_term(rule, f"({distortion}+p*({volume}-1)-sqr(p)/(2*{bulk}))*{TURN}")
    model.add_initialized_data("depth", [0.0])
    model.add_initialized_data("penalty", [float(data["penalty"])])
    model.add_nonlinear_term(rule, f"penalty*half_sqr_neg_part(X(2)+u(2)-depth)*{TURN}", CAP)
    model.add_Dirichlet_condition_with_multipliers(rule, "u", field, HELD)
    model.add_initialized_data("across", np.array([[1.0, 0.0], [0.0, 0.0]]))
    model.add_initialized_data("nothing", [0.0, 0.0])
    model.add_generalized_Dirichlet_condition_with_multipliers(rule, "u", field, AXIS, "nothing", "across")
    return model, rule, field


def contact_radius(model, field, depth):
    """Return where a line through gap^(2/3) of the free nodes up to half a radius beyond the edge is zero [mm].

    The nodes of the element in which the contact ends are left out: half in contact, it bends to and fro.
    """
    dof = np.sort(field.basic_dof_on_region(CAP))
    place = field.basic_dof_nodes(dof) + 0.0
    moved = model.variable("u")[dof]
    r, gap = place[0, 0::2] + moved[0::2], place[1, 1::2] + moved[1::2] - depth
    order = np.argsort(r)
    r, gap = r[order], gap[order]
    first = np.flatnonzero(gap < 0)[-1] + 3  # nodes and middles of edges take turns
    beside = slice(first, max(first + 4, np.searchsorted(r, 1.5 * r[first - 3])))
    slope, level = np.polyfit(r[beside], np.cbrt(gap[beside]) ** 2, 1)
    return float(-level / slope)


def main(source, target):
    """Solve and write."""
    gf.util_trace_level(0)
    with np.load(source, allow_pickle=False) as file:
        data = {key: file[key] for key in file.files}
    model, rule, field = build(data)
    out, last = [], 0.0
    for goal in data["depths"]:
        for depth in np.linspace(last, goal, int(np.ceil((goal - last) / 0.2)) + 1)[1:]:
            model.set_variable("depth", [depth])
            model.solve("max_res", 1e-8, "max_iter", 60)
        last = goal
        force = gf.asm_generic(rule, 0, f"penalty*neg_part(X(2)+u(2)-depth)*{TURN}", CAP, model)
        radius = contact_radius(model, field, goal)
        out.append({"depth": float(goal), "force": float(force), "radius": radius})
    with open(target, "w", encoding="utf-8") as file:
        json.dump(out, file)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
