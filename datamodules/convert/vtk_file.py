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
    errors: list[str] = []
    # Instead of text on stderr, after which the data is empty.
    reader.AddObserver("ErrorEvent", lambda *_: errors.append("error"))
    reader.SetFileName(str(path))
    if isinstance(reader, vtkDataSetReader):
        # By default only the first of each kind is read.
        reader.ReadAllScalarsOn()
        reader.ReadAllVectorsOn()
        reader.ReadAllFieldsOn()
    reader.Update()
    data = reader.GetOutput()
    if errors or data is None or not data.GetNumberOfPoints():
        raise UserError(f"{path}: VTK finds no points in it; the file is damaged or has none.")
    values = data.GetPointData()
    as_array: Callable[[Any], Any] = vtk_to_numpy
    names = [values.GetArrayName(index) for index in range(values.GetNumberOfArrays())]
    return Points(
        np.asarray(as_array(data.GetPoints().GetData())),
        {name: np.asarray(as_array(values.GetArray(name))) for name in names if name},
    )
