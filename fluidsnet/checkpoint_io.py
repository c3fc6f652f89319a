"""Reading and writing of checkpoint files."""

from __future__ import annotations

import os
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, final

import torch
from lightning.fabric.plugins import TorchCheckpointIO

from fluidsnet.checksums import refresh, verify
from fluidsnet.errors import UserError

#: Prefixes of the names of the models' weights, today and in an earlier version.
OWN_WEIGHTS = ("models.", "network.")


def check_made_here(path: Any, checkpoint: Any) -> None:
    """Check that a file that torch has read is a checkpoint of this program.

    Raises:
        UserError: It is that of another one.
    """
    weights = checkpoint.get("state_dict") if isinstance(checkpoint, dict) else None
    if (
        not isinstance(weights, dict)
        or "pytorch-lightning_version" not in checkpoint
        or not any(str(name).startswith(OWN_WEIGHTS) for name in weights)
    ):
        raise UserError(
            f"{path} is no checkpoint of fluidsnet: it holds no weights of its models. Name one "
            "that `fluidsnet fit` wrote, such as runs/demo/checkpoints/best.ckpt."
        )


@final
class WholeCheckpoints(TorchCheckpointIO):
    """Checkpoint files that are whole or not there, and that hold weights and plain values.

    A file is written under a temporary name in its folder and renamed, so that a full disk or a
    kill leaves the earlier one. Nothing but weights and plain values is unpickled: a checkpoint
    may come from someone else.
    """

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any | None = None
    ) -> None:
        """Write a checkpoint.

        Raises:
            UserError: The file cannot be written; the earlier one is whole.
        """
        file = Path(path)
        partial = file.with_name(f".{file.name}.{os.getpid()}.tmp")
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            with partial.open("wb") as stream:
                torch.save(checkpoint, stream)
                stream.flush()
                os.fsync(stream.fileno())
            partial.replace(file)
            refresh(file)
        except (OSError, RuntimeError) as error:
            # torch hides a full disk behind a RuntimeError.
            reason = getattr(error, "strerror", None) or "the disk may be full"
            kept = "; the earlier one is whole" if file.exists() else ""
            raise UserError(f"{file} cannot be written: {reason}{kept}.") from error
        finally:
            partial.unlink(missing_ok=True)

    def load_checkpoint(
        self, path: Any, map_location: Any = None, weights_only: bool | None = None
    ) -> dict[str, Any]:
        """Read a checkpoint onto the CPU.

        Raises:
            UserError: It is not a file, is damaged, holds other objects than weights, or is not
                that of its checksum.
        """
        if "://" in str(path):
            raise UserError(f"--ckpt_path {path} is an address; download the file and name that.")
        if not Path(path).is_file():
            raise UserError(f"--ckpt_path {path}: there is no such file.")
        verify(Path(path))
        try:
            read: dict[str, Any] = torch.load(
                path, map_location=map_location or "cpu", weights_only=True
            )
        except UnpicklingError as error:
            raise UserError(
                f"{path} holds objects other than weights and plain values, which are not loaded, "
                "since they can run code."
            ) from error
        except (OSError, EOFError, RuntimeError, KeyError, ValueError) as error:
            raise UserError(f"{path} cannot be read; it is damaged or no checkpoint.") from error
        check_made_here(path, read)
        return read
