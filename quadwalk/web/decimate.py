"""Visual meshes with fewer triangles, so that a phone can load and draw them."""

import mujoco
import numpy as np

MOST_FACES = 60_000  # of all visual meshes of a robot together
_FINEST = 5e-4  # m, the first grid to which vertices are moved


def decimate_visuals(spec: mujoco.MjSpec) -> tuple[mujoco.MjSpec, str | None]:
    """Return a robot with few visual triangles, and a line that says what was done.

    Vertices of visual meshes move to the points of a grid, which becomes coarser until the
    triangles that remain are few. Shapes that collide stay as they are.
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
    """Return vertices (k, 3), m, one for each cell of a grid, and the faces (l, 3) that remain."""
    cells = np.round(vertices / cell).astype(np.int64)
    _, first, group = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    merged = group.reshape(-1)[faces]
    a, b, c = merged.T
    merged = merged[(a != b) & (b != c) & (a != c)]
    merged = np.unique(merged, axis=0)
    used, renamed = np.unique(merged, return_inverse=True)
    return vertices[first][used], renamed.reshape(-1, 3).astype(np.int32)
