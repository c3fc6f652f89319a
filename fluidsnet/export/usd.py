"""USD files of particles and their surface, with a time sample a frame."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from fluidsnet.errors import UserError
from fluidsnet.export.frames import Frame, Frames
from fluidsnet.export.optional import load_optional
from fluidsnet.export.surface import Mesh

#: Frames between two saves, which empty the memory that samples take.
_SAVE_EVERY = 8

_SUFFIXES = (".usdc", ".usd")

#: Documentation of the root layer, by which the files of this class are known.
_DOCUMENTATION = "Particles of a fluid, written by FluidsNet."


class UsdFile:
    """Writer of a USD file, frame by frame; memory does not grow with the number of frames.

    Prims::

        /fluid             UsdGeomXform; translated if the positions are float64
        /fluid/particles   UsdGeomPoints: points (m), velocities (m/s), extent per time code;
                           widths (m, twice the particle radius) and ids once
        /fluid/surface     UsdGeomMesh: points, triangles, normals, velocities per time code

    Meters per unit is 1, and a time code is the time (s) × time codes per second. The file is
    binary, written beside its path under a temporary name and renamed over an older one of this
    class when the ``with`` block ends; an exception removes it.

    Args:
        path: Path of the file; it must end in .usdc or .usd.
        frames: Frames that will be written.
        rate: Time codes per second; by default a frame is a time code.

    Attributes:
        replaced: True if an older file is replaced.

    Raises:
        UserError: usd-core is not installed, the path is a file that another program wrote, or the
            path or rate cannot be used.
    """

    def __init__(self, path: Path, frames: Frames, rate: float | None = None) -> None:
        if path.suffix not in _SUFFIXES:
            raise UserError(f"{path}: the name of a USD file must end in .usdc or .usd.")
        if path.is_dir():
            raise UserError(f"{path} is a folder; choose another --output.")
        if rate is not None and not 0 < rate < np.inf:
            raise UserError(f"--fps is {rate}; set it above zero.")
        self.path, self._frames = path, frames
        self._rate = rate or frame_rate(frames)
        self._temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp.usdc")
        self._pxr = {name: load_optional(f"pxr.{name}", "usd-core") for name in _MODULES}
        self.replaced = path.exists()
        if self.replaced and not self._is_export():
            raise UserError(
                f"{path} exists and was not written by this command; choose another --output, or "
                "move it."
            )
        self._origin: NDArray[np.float64] = np.zeros(3)
        self._stage: Any = None
        self._points: Any = None
        self._mesh: Any = None
        self._written = 0

    def __enter__(self) -> Self:
        usd, geometry = self._pxr["Usd"], self._pxr["UsdGeom"]
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._temporary.touch()
            self._temporary.unlink()
        except OSError as error:
            raise UserError(f"{self.path}: cannot be written: {error}.") from error
        self._stage = stage = usd.Stage.CreateNew(str(self._temporary))
        stage.GetRootLayer().documentation = _DOCUMENTATION
        geometry.SetStageUpAxis(stage, up_axis(self._frames.gravity))
        geometry.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(self._rate)
        stage.SetFramesPerSecond(self._rate)
        codes = self._code(self._frames.times)
        stage.SetStartTimeCode(codes[0])
        stage.SetEndTimeCode(codes[-1])
        self._root = geometry.Xform.Define(stage, "/fluid")
        stage.SetDefaultPrim(self._root.GetPrim())
        return self

    def append(self, frame: Frame, surface: Mesh | None = None) -> None:
        """Write the samples of a frame.

        Args:
            frame: Particles.
            surface: Their surface; in every frame, or in none.
        """
        if self._points is None:
            self._define_points(frame)
        code = float(self._code(frame.time))
        radius = self._frames.radius()
        self._set_points(self._points, code, frame.position, frame.velocity, radius)
        if surface is not None:
            self._append_surface(code, surface)
        self._written += 1
        if self._written % _SAVE_EVERY == 0:
            self._save()

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        try:
            if kind is None:
                self._save()
                os.replace(self._temporary, self.path)
        finally:
            # Closes the file.
            self._points = self._mesh = self._root = self._stage = None
            self._temporary.unlink(missing_ok=True)

    def _is_export(self) -> bool:
        """Return True if the existing file is one of this class."""
        try:
            layer = self._pxr["Sdf"].Layer.OpenAsAnonymous(str(self.path), metadataOnly=True)
        except self._pxr["Tf"].ErrorException:
            return False
        return layer is not None and layer.documentation == _DOCUMENTATION

    def _save(self) -> None:
        try:
            self._stage.Save()
        except self._pxr["Tf"].ErrorException as error:
            raise UserError(
                f"{self.path}: cannot be written: USD could not save it; is the disk full?"
            ) from error

    def _code(self, time: Any) -> NDArray[np.float64]:
        # Rounded so that the codes of regular frames are whole.
        return np.round(np.asarray(time, np.float64) * self._rate, 6)

    def _define_points(self, frame: Frame) -> None:
        geometry, values = self._pxr["UsdGeom"], self._pxr["Vt"]
        if frame.position.dtype == np.float64:
            # Points are float32; the translation keeps the digits of places far from zero.
            finite = frame.position[np.isfinite(frame.position).all(axis=1)]
            self._origin = np.floor(finite.mean(axis=0)) if len(finite) else np.zeros(3)
            self._root.AddTranslateOp().Set(self._pxr["Gf"].Vec3d(*self._origin.tolist()))
        self._points = geometry.Points.Define(self._stage, "/fluid/particles")
        count = len(frame.position)
        widths = np.full(count, 2 * self._frames.radius(), np.float32)
        self._points.CreateWidthsAttr().Set(values.FloatArray.FromNumpy(widths))
        self._points.SetWidthsInterpolation(geometry.Tokens.vertex)
        ids = frame.ids.astype(np.int64)
        self._points.CreateIdsAttr().Set(values.Int64Array.FromNumpy(ids))

    def _append_surface(self, code: float, surface: Mesh) -> None:
        geometry, values = self._pxr["UsdGeom"], self._pxr["Vt"]
        if self._mesh is None:
            self._mesh = geometry.Mesh.Define(self._stage, "/fluid/surface")
            self._mesh.CreateSubdivisionSchemeAttr().Set(geometry.Tokens.none)
            self._mesh.SetNormalsInterpolation(geometry.Tokens.vertex)
        self._set_points(self._mesh, code, surface.vertices, surface.velocity, 0.0)
        counts = np.full(len(surface.triangles), 3, np.int32)
        self._mesh.GetFaceVertexCountsAttr().Set(values.IntArray.FromNumpy(counts), code)
        corners = values.IntArray.FromNumpy(surface.triangles.ravel())
        self._mesh.GetFaceVertexIndicesAttr().Set(corners, code)
        self._mesh.GetNormalsAttr().Set(values.Vec3fArray.FromNumpy(surface.normals), code)

    def _set_points(
        self,
        prim: Any,
        code: float,
        position: NDArray[Any],
        velocity: NDArray[np.float32],
        margin: float,
    ) -> None:
        """Set the samples that points and meshes have."""
        vectors = self._pxr["Vt"].Vec3fArray
        local = (position - self._origin if self._origin.any() else position).astype(np.float32)
        prim.GetPointsAttr().Set(vectors.FromNumpy(local), code)
        prim.GetVelocitiesAttr().Set(vectors.FromNumpy(velocity), code)
        finite = local[np.isfinite(local).all(axis=1)]
        if len(finite):
            box = np.stack([finite.min(axis=0) - margin, finite.max(axis=0) + margin])
            prim.GetExtentAttr().Set(vectors.FromNumpy(box.astype(np.float32)), code)


_MODULES = ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "Vt")


def up_axis(gravity: tuple[float, float, float]) -> str:
    """Return the up axis of a stage, Y or Z, against gravity; Y where gravity has neither."""
    return "Z" if abs(gravity[2]) > max(abs(gravity[0]), abs(gravity[1])) else "Y"


def frame_rate(frames: Frames) -> float:
    """Return the frames per second; 24 for a single frame."""
    if len(frames) < 2:
        return 24.0
    return round(float(1 / np.median(np.diff(frames.times))), 6)
