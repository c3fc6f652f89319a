"""``fluidsnet doctor``: versions, paths and missing packages of an installation."""

from __future__ import annotations

import ctypes
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

from fluidsnet.errors import UserError

_HELP = """usage: fluidsnet doctor

Print versions, what a step runs on, and which packages are not installed, with the command that
installs them. Paste the lines into a bug report.
"""

#: Environment variables that change how a step runs.
_VARIABLES = (
    "OMP_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "NUMBA_DISABLE_JIT",
    "NUMBA_CACHE_DIR",
    "CUDA_VISIBLE_DEVICES",
)
# In a process of its own, since the solver may crash where it is loaded.
_LOAD_SOLVER = "from datamodules.generate.solver import load_solver; load_solver()"


def doctor_command(arguments: Sequence[str]) -> None:
    """Run ``fluidsnet doctor``.

    Raises:
        UserError: There are arguments.
    """
    if any(it in ("-h", "--help") for it in arguments):
        print(_HELP, end="")
        return
    if arguments:
        raise UserError(f"doctor takes no arguments, and was given `{' '.join(arguments)}`.")
    parts: dict[str, Callable[[], str]] = {
        "fluidsnet": _fluidsnet,
        "system": lambda: f"Python {platform.python_version()}, {platform.platform()}",
        "packages": lambda: _versions("torch", "lightning", "numba", "numpy", "h5py"),
        "extensions": _extensions,
        "solver": _solver,
        "ParaView": lambda: _versions("vtk", "pyvista"),
        "device": _device,
        "kernels": _kernels,
        "kernel cache": _kernel_cache,
        "variables": _variables,
    }
    for name, describe in parts.items():
        try:
            text = describe()
        except Exception as error:  # a report of what works must not end at what does not
            text = f"failed: {type(error).__name__}: {error}"
        print(f"{name:<13}{text}", flush=True)
    if _installed("fluidsnet"):
        for line in missing(metadata.requires("fluidsnet") or []) or ["nothing"]:
            print(f"{'missing':<13}{line}")


def missing(requirements: Sequence[str]) -> list[str]:
    """Return a line for each extra that is not installed: its packages and the command.

    Args:
        requirements: Requirements of the package, as its metadata have them; those that belong to
            no extra are under the name FluidsNet.
    """
    absent: dict[str, list[str]] = {}
    for requirement in map(Requirement, requirements):
        # Such as `extra == "solver"`.
        extra = str(requirement.marker).split('"')[1] if requirement.marker else ""
        version = _installed(requirement.name)
        if version is None:
            absent.setdefault(extra, []).append(requirement.name)
        elif not requirement.specifier.contains(version, prereleases=True):
            found = f"{requirement.name}{requirement.specifier} (installed: {version})"
            absent.setdefault(extra, []).append(found)
    absent.pop("dev", None)
    return [
        f"{f'extra {extra}' if extra else 'required'}: {', '.join(names)}; run `{_command(extra)}`"
        for extra, names in sorted(absent.items())
    ]


def _command(extra: str) -> str:
    if extra == "scatter":
        from fluidsnet.torch_extensions import COMMAND

        return COMMAND
    return f"pip install 'fluidsnet[{extra}]'" if extra else "pip install fluidsnet"


def _installed(package: str) -> str | None:
    """Return the version of a package; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _versions(*packages: str) -> str:
    return ", ".join(f"{package} {_installed(package) or 'not installed'}" for package in packages)


def _fluidsnet() -> str:
    version = _installed("fluidsnet")
    return f"{version or 'not installed, only on the path'}, {Path(__file__).parent}"


def _extensions() -> str:
    """Return the versions of torch-scatter and torch-cluster, and why they cannot be loaded."""
    from fluidsnet.torch_extensions import MISSING

    found = _versions("torch-scatter", "torch-cluster")
    broken = [f"{name} cannot be loaded ({error})" for name, error in MISSING.items()]
    if not broken:
        return found
    return f"{found}; {', '.join(broken)}; shipped models run on the CPU without them"


def _solver() -> str:
    try:
        ctypes.CDLL("libGL.so.1")
        library = "libGL.so.1 found"
    except OSError:
        library = "libGL.so.1 not found (Debian, Ubuntu: apt-get install libgl1)"
    version = _installed("pysplishsplash")
    if version is None:
        return f"pysplishsplash not installed, {library}"
    loading = subprocess.run(
        [sys.executable, "-c", _LOAD_SOLVER], capture_output=True, text=True, errors="replace"
    )
    result = "loads"
    if loading.returncode < 0:
        result = f"crashes when it is loaded (signal {-loading.returncode})"
    elif loading.returncode > 0:
        result = f"cannot be loaded: {(loading.stderr.strip().splitlines() or ['?'])[-1]}"
    return f"pysplishsplash {version}, {result}, {library}"


def _device() -> str:
    import torch

    if torch.cuda.is_available():
        names = [torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())]
        return f"CUDA {torch.version.cuda or torch.version.hip}: {', '.join(names)}"
    if torch.version.cuda is None and torch.version.hip is None:
        return "CPU, since this torch has no CUDA"
    return "CPU, since torch finds no CUDA device"


def _kernels() -> str:
    """Return whether steps take the compiled kernels, and their threads."""
    import torch

    from fluidsnet.kernels.cache_folder import cache_folder
    from fluidsnet.kernels.threads import max_threads

    if cache_folder() is None:
        return "not compiled, since NUMBA_DISABLE_JIT is set: steps are very slow"
    elsewhere = "; on CUDA plain torch runs" if torch.cuda.is_available() else ""
    return (
        f"on, for float32 on the CPU, {max_threads()} threads of {torch.get_num_threads()} of "
        f"torch and {os.cpu_count()} cores{elsewhere}"
    )


def _kernel_cache() -> str:
    from fluidsnet.kernels.cache_folder import cache_folder

    folder = cache_folder()
    if folder is None:
        return "none"
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if os.access(existing, os.W_OK):
        return f"{folder}, writable"
    return f"{folder}, not writable: kernels are compiled again by each process"


def _variables() -> str:
    values = [f"{name}={os.environ[name]}" for name in _VARIABLES if name in os.environ]
    return ", ".join(values) or "none set"
