"""Opening of HDF5 files, and checks of how they store data before anything is read."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path

import h5py

from fluidsnet.errors import UserError
from fluidsnet.printable import printable

with suppress(ImportError):
    # Registers further compression filters, such as Blosc and Zstandard.
    import hdf5plugin  # noqa: F401


def open_file(path: Path) -> h5py.File:
    """Open an HDF5 file for reading.

    Raises:
        UserError: There is no such file, another process writes to it, or it is not whole.
    """
    try:
        if not path.exists():
            raise UserError(f"{path}: there is no such file; make it with `fluidsnet generate`.")
        if not path.is_file():
            raise UserError(f"{path}: it is a folder, a pipe or a device, and no data file.")
        return h5py.File(path, "r")
    except OSError as error:
        raise UserError(f"{path}: {_reason(error, path)}.") from error


def _reason(error: OSError, path: Path) -> str:
    """Return why a file cannot be opened, and what to do."""
    if isinstance(error, BlockingIOError):
        return (
            "another process has locked it, to write to it; wait until it is closed there. On a "
            "disk that has no working locks, set HDF5_USE_FILE_LOCKING=FALSE"
        )
    if "already open for write" in str(error):
        return (
            "a process writes to it, or ended before it closed it; if none is left, unlock it "
            f"with `h5clear -s {path}`"
        )
    if isinstance(error, PermissionError):
        return "you may not read it; ask its owner, or set its mode with chmod"
    return f"not a whole HDF5 file (damaged, truncated, or of another format): {error}"


def check_filters(dataset: h5py.Dataset) -> None:
    """Check that the filters that a data set was compressed with are installed.

    Raises:
        UserError: One is not.
    """
    stored = dataset.id.get_create_plist()
    for index in range(stored.get_nfilters()):
        number, _, _, name = stored.get_filter(index)
        if h5py.h5z.filter_avail(number):
            continue
        title = printable(name.decode("utf-8", "replace").partition(";")[0])
        called = f"{number} ({title})" if title else f"{number}"
        raise UserError(
            f"{dataset.name} is compressed with the HDF5 filter {called}, which is not installed; "
            "`pip install hdf5plugin` brings Blosc, Zstandard, LZ4 and others; or compress it anew "
            "with gzip where it can be read, as with `h5repack -f GZIP=1`."
        )


def check_stored(dataset: h5py.Dataset) -> None:
    """Check that a data set is stored whole, and in this file alone.

    Raises:
        UserError: Parts of it were never written, whatever its shape says, it takes its values
            from another file, or a filter to read it is not installed.
    """
    where = dataset.name
    if dataset.is_virtual or dataset.external:
        raise UserError(
            f"{where} takes its values from another file; copy them into this one, as with "
            "`h5repack`."
        )
    check_filters(dataset)
    if dataset.size == 0:
        return
    if dataset.chunks is not None:
        expected = math.prod(
            -(-size // chunk) for size, chunk in zip(dataset.shape, dataset.chunks, strict=True)
        )
        written = dataset.id.get_num_chunks()
        if written < expected:
            raise UserError(
                f"{where} has shape {dataset.shape}, and {expected - written:,} of its "
                f"{expected:,} chunks were never written: it holds less than it says."
            )
    elif dataset.id.get_storage_size() < dataset.nbytes:
        raise UserError(f"{where} has shape {dataset.shape} and was never written.")


def check_links(group: h5py.Group) -> None:
    """Check that nothing in a group is a link to another file.

    Raises:
        UserError: Something is.
    """
    for name in group:
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise UserError(
                f"{group.name.rstrip('/')}/{name} is a link to another file, {link.filename}; "
                "copy what it points to into this one."
            )
