"""Compile the wheels of torch-scatter and torch-cluster, once for each version of torch.

PyPI has their source only, and a wheel fits only the torch it was compiled against. The wheels
are kept in a folder of the user's cache that is named after that torch.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tools.jobs import VENV, InstallError, Job, run, say
from tools.venv import torch_version

# Number of source files without those for CUDA, to show the progress.
COMPILED = {"torch-scatter": 7, "torch-cluster": 16}


def builds_for_cuda() -> bool:
    """Return whether the packages will compile their CUDA parts, by the check that they use."""
    program = (
        "import torch; from torch.utils.cpp_extension import CUDA_HOME; "
        "gpu = torch.cuda.is_available(); "
        "print(gpu, gpu and (CUDA_HOME is not None or bool(torch.version.hip)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    if done.returncode != 0:
        raise InstallError(
            "torch is installed, but importing it fails, as shown above: run `make clean` and "
            "try again.",
            "\n".join(done.stderr.splitlines()[-15:]),
        )
    gpu, cuda = (word == "True" for word in done.stdout.split()[-2:])
    if gpu and not cuda:
        say(
            "There is a GPU but no CUDA compiler (nvcc), so torch-scatter and torch-cluster will "
            "run on the CPU only; install the CUDA toolkit and run this again to change that."
        )
    return cuda


def require_compiler() -> dict[str, str]:
    """Check that compiler and Python headers exist; return variables that name the compiler."""
    mac = sys.platform == "darwin"
    compilers = [os.environ.get("CXX", ""), "c++", "g++", "clang++"]
    compiler = next((c for c in compilers if c and shutil.which(shlex.split(c)[0])), None)
    if compiler is None:
        how = "`xcode-select --install`" if mac else "Debian: `apt-get install g++`"
        raise InstallError(
            f"torch-scatter and torch-cluster have to be compiled, and no C++ compiler was "
            f"found: install one ({how})."
        )
    if not (Path(sysconfig.get_path("include")) / "Python.h").exists():
        raise InstallError(
            "torch-scatter and torch-cluster have to be compiled, and Python's headers "
            "(Python.h) were not found: install them (Debian: `apt-get install python3-dev`)."
        )
    environment = {"CXX": compiler}
    linker = shlex.split(sysconfig.get_config_var("LDCXXSHARED") or "")
    if linker and "LDCXXSHARED" not in os.environ and not shutil.which(linker[0]):
        environment["LDCXXSHARED"] = shlex.join([*shlex.split(compiler), *linker[1:]])
    return environment


def jobs_each(packages: int) -> int:
    """Return the number of compilers per package that cores and memory (2 GiB each) allow."""
    if os.environ.get("MAX_JOBS", "").isdigit():
        return max(1, int(os.environ["MAX_JOBS"]))
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS
        cores = os.cpu_count() or 1
    gibibytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") >> 30
    return max(1, min(cores, gibibytes // 2) // packages)


@contextlib.contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder; the lock of a killed installation is released.

    Another installation that uses the folder is waited for.
    """
    import fcntl  # here, since Windows has none and is refused with a message first

    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("waiting for another installation that is compiling the same packages")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def compiled_wheels(versions: dict[str, str]) -> list[Path]:
    """Return the wheels of torch-scatter and torch-cluster; compile those that are missing."""
    cuda = builds_for_cuda()
    tag = "cp{}{}".format(*sys.version_info) + ("t" if "t" in sys.abiflags else "")
    platform = re.sub(r"\W", "_", sysconfig.get_platform())
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "fluidsnet/wheels" / f"{tag}-torch{torch_version()}-{platform}"
    if cuda:
        folder = folder.with_name(folder.name + "-cuda")
    folder.mkdir(parents=True, exist_ok=True)

    def wheels(name: str) -> list[Path]:
        return sorted(folder.glob(f"{name.replace('-', '_')}-{versions[name]}-*.whl"))

    with alone_in(folder):
        for leftover in folder.glob("building-*"):
            shutil.rmtree(leftover, ignore_errors=True)
        missing = [name for name in versions if not wheels(name)]
        if missing:
            environment = require_compiler()
            say(
                f"{' and '.join(missing)}: source only, and bound to torch {torch_version()}, so "
                "compiled here, once, in about 8 to 16 minutes on two cores. The result is kept "
                f"in {folder}"
            )
            build(missing, versions, folder, environment, parallel=not cuda)
        return [wheels(name)[0] for name in versions]


def build(
    names: list[str],
    versions: dict[str, str],
    folder: Path,
    environment: dict[str, str],
    parallel: bool,
) -> None:
    """Compile packages in parallel; a wheel is moved to the folder when it is complete."""
    each = jobs_each(len(names))
    with tempfile.TemporaryDirectory(
        prefix="building-", dir=folder, ignore_cleanup_errors=True
    ) as scratch:
        settings = Path(scratch) / "build.cfg"
        # Both packages compile without ninja, and setuptools would take one file at a time. Not
        # for CUDA: torch changes the compiler object that setuptools' threads share.
        settings.write_text(f"[build_ext]\nparallel = {each}\n" if parallel else "")
        environment = {
            **environment,
            "MAX_JOBS": str(each),
            "DIST_EXTRA_CONFIG": str(settings),
            # Without debug information, a third of the compiler's work, which is stripped anyway.
            # CPPFLAGS add to Python's flags; CFLAGS and CXXFLAGS would replace them.
            "CPPFLAGS": f"{os.environ.get('CPPFLAGS', '')} -g0",
            "PATH": f"{VENV / 'bin'}{os.pathsep}{os.environ['PATH']}",
            "PYTHONUNBUFFERED": "1",
        }

        def job(name: str) -> Job:
            temporary, finished = Path(scratch) / f"{name}-temporary", Path(scratch) / name
            temporary.mkdir()

            def move() -> None:
                for wheel in finished.glob("*.whl"):
                    wheel.replace(folder / wheel.name)

            # No cache: pip does not tell wheels for different torch versions apart.
            options = ["-v", "--no-build-isolation", "--no-deps", "--no-cache-dir"]
            requirement = f"{name}=={versions[name]}"
            return Job(
                f"building {name}",
                [sys.executable, "-m", "pip", "wheel", *options, "-w", str(finished), requirement],
                log=folder / f"{name}.log",
                environment={**environment, "TMPDIR": str(temporary)},
                sources=str(COMPILED[name]) if parallel else "many",
                when_done=move,
            )

        run(*(job(name) for name in names))
