"""Orient the faces: coherently within each patch, outward outside and inward in cavities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, at_faces
from vhp_cli.kernels.repairing import mates, orient_patches
from vhp_cli.kernels.spatial import KIND_TOUCH, Tree
from vhp_cli.kernels.surface import topology
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import face_areas

# An open patch that encloses less than this, with its borders closed, over area^1.5 has no inside worth the name.
_FLAT = 1e-3
# Pairs of faces listed to see which components cross.
_MOST_PAIRS = 100_000


def orient(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Orient a mesh.

    Patches are faces joined by edges with exactly two faces. A closed one faces outward if an even number of other
    closed ones contain it, inward (a cavity) if that number is odd; those that cross others face outward. An open one
    faces outward as if its borders were closed; a flat one stays as most of its faces are.

    Parameters
    ----------
    mesh
        Any mesh without collapsed faces.

    Returns
    -------
    mesh, actions
        Patches that can't be oriented, as a Moebius strip, are named and left alone.
    """
    if not len(mesh.faces):
        return mesh, []
    glued, _ = mates(mesh.faces, len(mesh.vertices))
    turned, patch, twisted = orient_patches(mesh.faces, glued)
    turned &= ~twisted[patch]
    n_patches = len(twisted)
    areas = face_areas(mesh)
    # Disturb as little as possible: the larger part of a patch stays as it is.
    turned ^= (np.bincount(patch, np.where(turned, areas, -areas), minlength=n_patches) > 0)[patch]
    faces = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)

    is_open = np.zeros(n_patches, np.bool_)
    is_open[patch[(glued < 0).any(axis=1)]] = True
    is_open |= twisted
    volumes = patch_volumes(mesh.vertices, faces, patch, n_patches)
    patch_areas = np.bincount(patch, areas, minlength=n_patches)
    inside_out = (volumes < 0) & (np.abs(volumes) > _FLAT * patch_areas**1.5) & ~twisted
    closed = np.flatnonzero(~is_open)
    if len(closed):
        inside_out[closed] = volumes[closed] < 0
        inside_out[closed] ^= _is_cavity(mesh, patch, is_open)[closed]
    turned ^= inside_out[patch]

    actions: list[Action] = []
    changed = np.flatnonzero(turned)
    if len(changed):
        first = np.unique(patch[changed], return_index=True)[1]
        actions.append(
            {
                "step": "orientation",
                "message": f"{len(changed)} faces turned round",
                "count": len(changed),
                "places": at_faces(mesh, changed[first[:MAX_PLACES]]),
            }
        )
        mesh = Mesh(mesh.vertices, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces))
    for strip in np.flatnonzero(twisted):
        own = np.flatnonzero(patch == strip)
        actions.append(
            {
                "step": "orientation",
                "message": f"a patch of {len(own)} faces is one-sided: it can't be oriented",
                "count": 0,
                "places": at_faces(mesh, own[:1]),
            }
        )
    return mesh, actions


def patch_volumes(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], patch: NDArray[np.int32], n_patches: int
) -> NDArray[np.float64]:
    """Return the volume within each patch in mm3; each border of an open one is closed by a cone to the mean of it.

    Parameters
    ----------
    vertices, faces
        The mesh, oriented coherently within each patch.
    patch : (F,) int32
        Patch of each face, numbered by their first faces.
    n_patches
        Number of patches.
    """
    # About a vertex of its own, for the sake of rounding.
    origin = vertices[faces[np.unique(patch, return_index=True)[1], 0]]

    def volume(of: NDArray[np.int32], *corners: NDArray[np.float64]) -> NDArray[np.float64]:
        a, b, c = (corner - origin[of] for corner in corners)
        return np.bincount(of, np.einsum("ij,ij->i", a, np.cross(b, c)) / 6, minlength=n_patches).astype(np.float64)

    within = volume(patch, *(vertices[faces[:, k]] for k in range(3)))
    borders = topology(vertices, faces)
    if not len(borders.boundary_edges):
        return within
    edges, beside, loop = borders.boundary_edges, faces[borders.boundary_faces], borders.boundary_loop
    along = ((beside == edges[:, :1]) & (np.roll(beside, -1, axis=1) == edges[:, 1:])).any(axis=1)
    edges = np.where(along[:, None], edges, edges[:, ::-1])
    middles = vertices[edges].mean(axis=1)
    centres = np.stack([np.bincount(loop, middles[:, d]) for d in range(3)], axis=1) / np.bincount(loop)[:, None]
    return within + volume(patch[borders.boundary_faces], vertices[edges[:, 1]], vertices[edges[:, 0]], centres[loop])


def _is_cavity(mesh: Mesh, patch: NDArray[np.int32], is_open: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which closed patches lie within an odd number of others, of those that do not cross any."""
    n_patches = len(is_open)
    alone = ~is_open
    if alone.sum() < 2:
        return np.zeros(n_patches, np.bool_)
    chosen = alone[patch]
    tree = Tree(mesh.vertices, mesh.faces[chosen])
    labels = patch[chosen]
    hits = tree.self_hits(_MOST_PAIRS)
    pairs = labels[hits.pairs[hits.kinds != KIND_TOUCH]]
    alone[pairs[pairs[:, 0] != pairs[:, 1]].ravel()] = False
    number = np.cumsum(alone) - 1
    depths, _ = tree.component_depths(np.where(alone[labels], number[labels], -1).astype(np.int32), int(alone.sum()))
    cavity = np.zeros(n_patches, np.bool_)
    cavity[alone] = depths % 2 == 1
    return cavity
