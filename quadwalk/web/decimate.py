"""Visual meshes with fewer triangles, so that a phone can load and draw them."""

import mujoco
import numpy as np

MOST_FACES = 60_000  # of all visual meshes of a robot together
_FINEST = 5e-4  # m, the first grid to which vertices are moved


def decimate_visuals(spec: mujoco.MjSpec) -> tuple[mujoco.MjSpec, str | None]:
    """Return a copy with few visual triangles, and a line that says so; None if nothing changed.

    All vertices in one cell of a grid become one of them. The grid becomes coarser until the
    triangles are few enough. Shapes that collide stay as they are.
    """
    spec = spec.copy()
    solid = {geom.meshname for geom in spec.geoms if geom.contype or geom.conaffinity}
    shapes = {
        mesh.name: (np.reshape(mesh.uservert, (-1, 3)), np.reshape(mesh.userface, (-1, 3)))
        for mesh in spec.meshes
        if mesh.name not in solid and len(mesh.userface)
    }
    before, cell = count_faces(shapes), _FINEST
    if before <= MOST_FACES:
        return spec, None
    while count_faces(shapes) > MOST_FACES:
        for name, shape in shapes.items():
            vertices, faces = merge_vertices(*shape, cell)
            if len(faces) >= 4:  # else it would vanish
                shapes[name] = vertices, faces
        cell *= 1.4
    for name, (vertices, faces) in shapes.items():
        replace_mesh(spec, name, vertices, faces)
    return spec, f"{before:,} triangles were made {count_faces(shapes):,}"


def replace_mesh(spec: mujoco.MjSpec, name: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Put a new mesh in the place of the one of this name; it keeps nothing of the old one."""
    old = spec.mesh(name)
    new = spec.add_mesh(
        name=f"{name}_light", uservert=vertices.ravel(), userface=faces.ravel(), inertia=old.inertia
    )
    for geom in spec.geoms:
        if geom.meshname == name:
            geom.meshname = new.name
    spec.delete(old)


def count_faces(shapes: dict[str, tuple[np.ndarray, np.ndarray]]) -> int:
    """Return the number of triangles of all shapes."""
    return sum(len(faces) for _, faces in shapes.values())


def merge_vertices(
    vertices: np.ndarray, faces: np.ndarray, cell: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return one vertex for each cell of a grid (k, 3), m, and the faces (l, 3) between them.

    `vertices` are (n, 3), m, `faces` (m, 3) indices, `cell` is a cell's edge, m. Of a cell's
    vertices the first stays. Faces with two vertices in one cell, and doubles, are dropped.
    """
    cells = np.round(vertices / cell).astype(np.int64)
    _, first, group = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    merged = group.reshape(-1)[faces]
    a, b, c = merged.T
    merged = merged[(a != b) & (b != c) & (a != c)]
    merged = np.unique(merged, axis=0)
    used, renamed = np.unique(merged, return_inverse=True)
    return vertices[first][used], renamed.reshape(-1, 3).astype(np.int32)
