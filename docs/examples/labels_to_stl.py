"""Make one STL file of each label of a segmentation: ``python labels_to_stl.py LABELS.nii.gz MODEL [NAMES.json]``.

LABELS is a NIfTI file of whole numbers, such as TotalSegmentator writes with ``--ml``; 0 is what is outside. MODEL is a
new directory. NAMES holds the names of labels: ``{"1": "spleen", "2": "kidney_right"}``. Needs nibabel, scikit-image
and vhp. Coordinates are those of the scanner in mm, x to the right and y to the front (RAS).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import nibabel
import numpy as np
from scipy.ndimage import find_objects, gaussian_filter
from skimage.measure import marching_cubes

from vhp_cli.formats import write_mesh
from vhp_cli.mesh import Mesh

# The steps of voxels are blurred by so many voxels before the surface is taken; volumes hardly change by that.
BLUR = 0.7


def surface(mask: np.ndarray, corner: np.ndarray, affine: np.ndarray) -> Mesh:
    """Return the surface of a mask in mm; `corner` is the voxel at which the mask begins."""
    padded = np.pad(mask, 3).astype(np.float32)
    blurred = gaussian_filter(padded, BLUR)
    # What is only a voxel thick would be blurred away.
    vertices, faces, _, _ = marching_cubes(blurred if blurred.max() > 0.5 else padded, 0.5)
    points = (vertices + corner - 3) @ affine[:3, :3].T + affine[:3, 3]
    a, b, c = (points[faces[:, side]] for side in range(3))
    inward = np.einsum("ij,ij->", a, np.cross(b, c)) < 0
    return Mesh(points, faces[:, ::-1] if inward else faces)


def main(labels: Path, out: Path, names: Path | None = None) -> None:
    """Write a file for each label that there is."""
    image = nibabel.load(labels)
    voxels = np.asarray(image.dataobj).astype(np.int32)
    known = json.loads(names.read_text(encoding="utf-8")) if names else {}
    out.mkdir(parents=True)
    for label, box in enumerate(find_objects(voxels), start=1):
        if box is not None:
            corner = np.array([part.start for part in box])
            name = known.get(str(label), f"label_{label:03d}")
            write_mesh(out / f"{name}.stl", surface(voxels[box] == label, corner, image.affine))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
