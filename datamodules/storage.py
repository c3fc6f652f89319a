"""Checks of how a file stores its data, before anything is read or allocated."""

from __future__ import annotations

import math

import h5py

from fluidsnet.errors import UserError


def check_stored(dataset: h5py.Dataset) -> None:
    """Check that a data set is stored whole, and in this file alone.

    Raises:
        UserError: Parts of it were never written, whatever its shape says, or it takes its values
            from another file.
    """
    where = dataset.name
    if dataset.is_virtual or dataset.external:
        raise UserError(
            f"{where} takes its values from another file; copy them into this one, as with "
            "`h5repack`."
        )
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
