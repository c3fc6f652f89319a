"""Points of a VTK file: legacy (.vtk), polygonal data (.vtp), unstructured grid (.vtu)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.convert.points import Points
from fluidsnet.errors import UserError


def read_vtk(path: Path) -> Points:
    """Read positions and point data.

    Raises:
        UserError: VTK is not installed, or cannot read the file.
    """
    try:
        from vtkmodules.util.numpy_support import vtk_to_numpy
        from vtkmodules.vtkIOLegacy import vtkDataSetReader
        from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader
    except ImportError as error:
        raise UserError(
            "VTK files need VTK: install it with `pip install 'fluidsnet[vtk]'`."
        ) from error
    reader: Any = {
        ".vtk": vtkDataSetReader,
        ".vtp": vtkXMLPolyDataReader,
        ".vtu": vtkXMLUnstructuredGridReader,
    }[path.suffix.lower()]()
    reader.SetFileName(str(path))
    if isinstance(reader, vtkDataSetReader):
        # By default only the first of each kind is read.
        reader.ReadAllScalarsOn()
        reader.ReadAllVectorsOn()
        reader.ReadAllFieldsOn()
    data, complaints = _output(reader)
    if "error" in complaints.lower() or data is None or not data.GetNumberOfPoints():
        raise UserError(f"{path}: VTK cannot read its points; the file is damaged or has none.")
    values = data.GetPointData()
    as_array: Callable[[Any], Any] = vtk_to_numpy
    position = np.asarray(as_array(data.GetPoints().GetData()))
    names = [values.GetArrayName(index) for index in range(values.GetNumberOfArrays())]
    fields = {name: np.asarray(as_array(values.GetArray(name))) for name in names if name}
    if path.suffix.lower() == ".vtk":
        _check_text(path, position.size + sum(it.size for it in fields.values()))
    return Points(position, fields)


def _output(reader: Any) -> tuple[Any, str]:
    """Return the output of a reader, and the text of its errors and warnings.

    A file that ends too early is a warning, after which the rest of the values is arbitrary.
    """
    from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow

    usual, window = vtkOutputWindow.GetInstance(), vtkStringOutputWindow()
    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    vtkOutputWindow.SetInstance(window)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        reader.Update()
        data = reader.GetOutput()
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)
        vtkOutputWindow.SetInstance(usual)
    return data, str(window.GetOutput())


def _check_text(path: Path, count: int) -> None:
    """Check that a legacy file, if it is text, has as many numbers as VTK returned.

    VTK reads a text that ends too early without a word.
    """
    header, _, rest = path.read_bytes().partition(b"POINTS")
    if b"ASCII" in header and len(rest.split()) < count:
        raise UserError(f"{path}: it ends before its values do; the file is damaged.")
