"""Surface meshes of fluids by splashsurf.

The surface is an isosurface of the SPH color field, by marching cubes, smoothed with weights that
keep the volume of thin parts: Löschner et al., Weighted Laplacian Smoothing for Surface
Reconstruction of Particle-based Fluids, VMV 2023.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fluidsnet.errors import UserError
from fluidsnet.export.frames import Frame
from fluidsnet.export.optional import load_optional

#: File formats of meshes.
MeshFormat = Literal["ply", "obj", "vtk"]


@dataclass(frozen=True)
class SurfaceSettings:
    """Settings of the surface reconstruction; the defaults are those that splashsurf recommends.

    Attributes:
        smoothing_length: Half the support radius of the kernel, in particle radii.
        cube_size: Edge of a cube of the grid, in particle radii.
        threshold: Value of the color field at the surface; 1 is inside the fluid, 0 outside.
        smoothing_iterations: Iterations of the weighted smoothing of the vertices; 0 for none.
        normal_iterations: Iterations of the smoothing of the normals; 0 for none.
    """

    smoothing_length: float = 2.0
    cube_size: float = 0.5
    threshold: float = 0.6
    smoothing_iterations: int = 25
    normal_iterations: int = 10

    def __post_init__(self) -> None:
        for name in ("smoothing_length", "cube_size", "threshold"):
            if not 0 < getattr(self, name) < np.inf:
                raise UserError(f"--mesh.{name} is {getattr(self, name)}; set it above zero.")
        for name in ("smoothing_iterations", "normal_iterations"):
            if getattr(self, name) < 0:
                raise UserError(f"--mesh.{name} is {getattr(self, name)}; set at least 0.")


@dataclass(frozen=True)
class Mesh:
    """Triangle mesh of a surface.

    Attributes:
        vertices: (V, 3), m, float32, or float64 if the particles' positions are.
        triangles: (F, 3) int32 rows of `vertices`, counterclockwise seen from outside.
        normals: (V, 3) float32, outward.
        velocity: (V, 3) float32, m/s, interpolated from the particles.
    """

    vertices: NDArray[Any]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32]
    velocity: NDArray[np.float32]


def reconstruct(
    frame: Frame, particle_radius: float, settings: SurfaceSettings, threads: bool = False
) -> Mesh:
    """Return the surface of the fluid in a frame.

    Args:
        frame: Particles in three dimensions.
        particle_radius: m.
        settings: Settings of the reconstruction.
        threads: Use all cores for this frame.

    Raises:
        UserError: pysplashsurf is not installed, or a position or velocity is not finite.
    """
    pysplashsurf = load_optional("pysplashsurf", "pysplashsurf")
    finite = np.isfinite(frame.position).all(axis=1) & np.isfinite(frame.velocity).all(axis=1)
    if not finite.all():
        raise UserError(
            f"At {frame.time:g} s, {np.count_nonzero(~finite)} of {len(finite)} particles have no "
            "finite position or velocity, so there is no surface; end before with --last."
        )
    mesh, _ = pysplashsurf.reconstruction_pipeline(
        frame.position,
        attributes_to_interpolate={"velocity": frame.velocity.astype(frame.position.dtype)},
        particle_radius=particle_radius,
        smoothing_length=settings.smoothing_length,
        cube_size=settings.cube_size,
        iso_surface_threshold=settings.threshold,
        mesh_cleanup=True,
        mesh_smoothing_iters=settings.smoothing_iterations or None,
        mesh_smoothing_weights=settings.smoothing_iterations > 0,
        compute_normals=True,
        normals_smoothing_iters=settings.normal_iterations or None,
        multi_threading=threads,
    )
    columns = mesh.point_attributes
    return Mesh(
        np.asarray(mesh.mesh.vertices),
        np.asarray(mesh.mesh.triangles, np.int32),
        np.asarray(columns["normals"], np.float32),
        np.asarray(columns["velocity"], np.float32),
    )


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh as .ply (binary), .obj or legacy .vtk (binary), by the suffix of the path.

    PLY has the properties nx, ny, nz and vx, vy, vz, VTK the point data normals and velocity;
    OBJ has neither.

    Raises:
        UserError: meshio is not installed.
    """
    meshio = load_optional("meshio", "meshio")
    data: dict[str, NDArray[Any]] = {}
    if path.suffix == ".ply":
        data |= zip(("nx", "ny", "nz"), mesh.normals.T, strict=True)
        data |= zip(("vx", "vy", "vz"), mesh.velocity.T, strict=True)
    elif path.suffix == ".vtk":
        data |= {"normals": mesh.normals, "velocity": mesh.velocity}
    written = meshio.Mesh(mesh.vertices, [("triangle", mesh.triangles)], point_data=data)
    meshio.write(path, written, file_format={".vtk": "vtk42"}.get(path.suffix, path.suffix[1:]))
