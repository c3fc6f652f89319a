"""Installs FluidsNet and what it needs into `.venv`; `make setup` runs it.

It knows only the standard library. Started by any Python, it makes `.venv` and starts itself
again with the Python in there, which does the rest. Where nothing has changed since the last
time, it ends at once.

torch-scatter and torch-cluster come as source only and fit only the torch they were compiled
against. They are compiled once, into a folder of the user's cache that is named after that torch.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
STAMP = VENV / ".fluidsnet-installed"
LOG = VENV / "fluidsnet-install.log"

# A plain `torch` may be a CUDA build of several GB; this is the release the tests run with.
DEFAULT_TORCH = "torch==2.13.0"
# Source files of each, without those for CUDA; only to show how far it has come.
COMPILED = {"torch-scatter": 7, "torch-cluster": 16}
OLDEST_PYTHON = (3, 11)

# How the Python that starts this tells the one in `.venv` where the user's torch is.
TORCH_FOLDER_VARIABLE = "FLUIDSNET_TORCH_FOLDER"

SECONDS_BETWEEN_LINES = 30.0
COMPILING = re.compile(r"^\s*(\[\d+/\d+\]|\S*(g\+\+|c\+\+|clang|cc)\S*\s.*\s-c\s)", re.MULTILINE)
# By name, since Windows has no SIGHUP.
STOPPING = [s for s in signal.Signals if s.name in ("SIGINT", "SIGTERM", "SIGHUP")]


class InstallError(Exception):
    """What is wrong and what to do about it, in one sentence; `details` is printed before it."""

    def __init__(self, sentence: str, details: str = "") -> None:
        super().__init__(sentence)
        self.details = details


def say(sentence: str) -> None:
    """Prints a line at once."""
    print(sentence, flush=True)


# --- Running commands and showing that something happens -------------------------------------


@dataclass
class Job:
    """A command, shown by its title while it runs; its output goes to a log."""

    title: str
    command: list[str]
    log: Path = LOG
    environment: dict[str, str] = field(default_factory=dict)
    sources: str | None = None  # how many source files it compiles, if it does
    when_done: Callable[[], None] = lambda: None
    process: subprocess.Popen[bytes] = field(init=False)
    began: float = field(init=False)

    def start(self) -> None:
        """Starts the command in a group of its own, so that all of it can be stopped."""
        self.began = time.monotonic()
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                self.command,
                cwd=ROOT,
                env={**os.environ, **self.environment},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def stop(self) -> None:
        """Ends the command and whatever it has started, if it still runs."""
        if self.process.poll() is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGTERM)
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)

    def progress(self) -> str:
        """The title, what has been compiled so far, and the time it has taken."""
        seconds = f"{time.monotonic() - self.began:.0f} s"
        if self.sources is None:
            return f"{self.title}: {seconds}"
        begun = len(COMPILING.findall(self.log.read_text(errors="replace")))
        return f"{self.title}: file {begun} of {self.sources}, {seconds}"

    def tail(self) -> str:
        """The last 15 lines of the log, up to where pip begins to clean up after a failure."""
        text = self.log.read_text(errors="replace").split("error: subprocess-exited-with-error")[0]
        return "\n".join(text.rstrip().splitlines()[-15:])


def run(*jobs: Job) -> None:
    """Runs jobs side by side; the first to fail ends them all."""
    terminal = sys.stdout.isatty()
    clear = "\r\033[K" if terminal else ""
    running: list[Job] = []
    try:
        for job in jobs:
            job.start()
            running.append(job)
        next_line = time.monotonic() + (0 if terminal else SECONDS_BETWEEN_LINES)
        if not terminal:
            say("; ".join(job.title for job in jobs) + " …")
        while running:
            time.sleep(0.2)
            for job in [job for job in running if job.process.poll() is not None]:
                running.remove(job)
                print(clear, end="")
                if job.process.returncode != 0:
                    raise InstallError(f"{job.title} failed; its log is {job.log}.", job.tail())
                job.when_done()
                say(f"{job.progress()}, done")
            if running and time.monotonic() >= next_line:
                line = "; ".join(job.progress() for job in running)
                if terminal:
                    width = shutil.get_terminal_size().columns - 1
                    print(clear + line[:width], end="", flush=True)
                    next_line += 1
                else:
                    say(line)
                    next_line += SECONDS_BETWEEN_LINES
    finally:
        for job in running:
            job.stop()


def pip_install(title: str, *arguments: str) -> None:
    """Runs pip in `.venv`, quietly."""
    run(Job(title, [sys.executable, "-m", "pip", "install", "-q", *arguments]))


# --- .venv ------------------------------------------------------------------------------------


def torch_folder() -> Path | None:
    """The folder that holds the torch this Python would import, found without importing it."""
    spec = importlib.util.find_spec("torch")
    return Path(spec.origin).parent.parent if spec and spec.origin else None


def torch_version() -> str | None:
    """As `torch.__version__`, which, unlike the package's, always says what it was built for."""
    folder = torch_folder()
    if folder is None:
        return None
    found = re.search(r"__version__ = '([^']+)'", (folder / "torch/version.py").read_text())
    return found.group(1) if found else importlib.metadata.version("torch")


def require_python() -> None:
    """Refuses a Python that is too old."""
    if sys.version_info < OLDEST_PYTHON:
        raise InstallError(
            f"FluidsNet needs Python {OLDEST_PYTHON[0]}.{OLDEST_PYTHON[1]} or newer and this is "
            f"{sys.version.split()[0]}: run `make clean`, then name a newer one, "
            "as in `make setup PYTHON=python3.12`."
        )


def make_venv(*options: str) -> None:
    """Makes `.venv`, or gives an existing one other options."""
    require_python()
    done = subprocess.run(
        [sys.executable, "-m", "venv", *options, str(VENV)], capture_output=True, text=True
    )
    if done.returncode != 0:
        raise InstallError(
            f"{sys.executable} cannot make a virtual environment: install its venv module "
            "(Debian: `apt-get install python3-venv`).",
            (done.stdout + done.stderr).strip(),
        )


def enter_venv() -> NoReturn:
    """Makes `.venv` where it is missing, and goes on with the Python in it."""
    python = VENV / "bin/python"
    if not python.exists():
        say("making .venv")
        make_venv("--clear")
    environment = {**os.environ}
    environment.pop(TORCH_FOLDER_VARIABLE, None)
    packages = VENV / "lib/python{}.{}/site-packages".format(*sys.version_info)
    folder = torch_folder()
    if (
        folder is not None
        and not os.environ.get("TORCH")
        and packages.is_dir()
        and not (packages / "torch").exists()
    ):
        # A virtual environment made from another one sees the system's packages, not the other
        # one's; for those, the Python in `.venv` is told the folder.
        shared = "include-system-site-packages = true" in (VENV / "pyvenv.cfg").read_text()
        if sys.prefix == sys.base_prefix and not shared:
            make_venv("--system-site-packages")
        environment[TORCH_FOLDER_VARIABLE] = str(folder)
    os.execve(python, [str(python), str(Path(__file__).resolve())], environment)


# --- The steps, all in .venv ------------------------------------------------------------------


def fingerprint() -> str:
    """Changes whenever the installation has to be looked at again."""
    parts = [ROOT / "pyproject.toml", Path(__file__).resolve()]
    facts = f"{ROOT} {sys.version} {torch_version()}"
    return hashlib.sha256(b"".join(p.read_bytes() for p in parts) + facts.encode()).hexdigest()


def is_up_to_date() -> bool:
    """Whether the last installation ended well, with all as it is now."""
    try:
        stamp = json.loads(STAMP.read_text())
    except (OSError, ValueError):
        return False
    wanted = os.environ.get("TORCH") or stamp["torch"]
    return bool(stamp["fingerprint"] == fingerprint() and stamp["torch"] == wanted)


def install_torch(oldest: str) -> None:
    """Sees to it that there is a torch, preferring one that is there already."""
    asked = os.environ.get("TORCH")
    users = os.environ.get(TORCH_FOLDER_VARIABLE)
    if asked:
        pip_install(f"installing {asked}", *shlex.split(asked))
    elif users:
        if torch_folder() is None:
            link = Path(sysconfig.get_path("purelib")) / "fluidsnet_torch.pth"
            link.write_text(f"{users}\n")
            sys.path.append(users)
        say(f"keeping the torch {torch_version()} that is there, in {torch_folder()}")
    elif torch_folder() is None:
        pip_install(f"installing {DEFAULT_TORCH}", DEFAULT_TORCH)
    importlib.invalidate_caches()
    version = torch_version() or "0.0"
    if [int(n) for n in version.split(".")[:2]] < [int(n) for n in oldest.split(".")[:2]]:
        raise InstallError(
            f"torch {version} is too old, FluidsNet needs {oldest}: install another into .venv "
            f'with `make setup TORCH="{DEFAULT_TORCH}"`.'
        )


def lower_bound(requirement: str) -> str:
    """`2.1.2` of `torch-scatter>=2.1.2,<3`."""
    return requirement.split(">=")[1].split(",")[0]


def builds_for_cuda() -> bool:
    """Whether the packages will compile their CUDA parts; the same question as they ask."""
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
    """Refuses to begin what would fail after minutes; returns variables that name the compiler."""
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
    """Compilers a package may run at once: all cores in use, and 2 GiB for each compiler."""
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
    """Waits until no other installation uses the folder; a killed one leaves no lock behind."""
    import fcntl  # here, so that Windows, which lacks it, gets as far as being told so

    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("waiting for another installation that is compiling the same packages")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def compiled_wheels(versions: dict[str, str]) -> list[Path]:
    """The wheels of torch-scatter and torch-cluster for this torch, compiled where missing."""
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
    """Compiles packages side by side; a wheel appears in the folder only when it is whole."""
    each = jobs_each(len(names))
    with tempfile.TemporaryDirectory(
        prefix="building-", dir=folder, ignore_cleanup_errors=True
    ) as scratch:
        settings = Path(scratch) / "build.cfg"
        # Both packages compile without ninja, one file at a time unless setuptools is told
        # otherwise. It shares one compiler object between threads, which torch changes for CUDA.
        settings.write_text(f"[build_ext]\nparallel = {each}\n" if parallel else "")
        environment = {
            **environment,
            "MAX_JOBS": str(each),
            "DIST_EXTRA_CONFIG": str(settings),
            # Debug information is a third of the compiler's work, and is stripped in the end.
            # These flags are added to Python's own; CFLAGS and CXXFLAGS would replace them.
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

            # pip's cache does not know which torch a wheel was compiled against.
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


def install_solver(requirement: str, constraints: list[str]) -> None:
    """Installs the solver where it has a wheel, and says what is missing where it does not run."""
    only_wheel = ["--only-binary", "pysplishsplash"]
    try:
        pip_install("installing the solver", *only_wheel, *constraints, requirement)
    except InstallError:
        say(
            "The solver (pysplishsplash) could not be installed, most likely because it has no "
            "wheel for this platform: training and the demo work, generating data does not."
        )
        return
    if sys.platform.startswith("linux"):
        try:
            ctypes.CDLL("libGL.so.1")
        except OSError:
            say(
                "libGL.so.1 was not found: training and the demo work without it, generating "
                "data needs it (Debian: `apt-get install libgl1`)."
            )


def install() -> None:
    """Every step, in `.venv`; those already done cost seconds."""
    import tomllib  # here, so that a Python without it gets as far as being told so

    STAMP.unlink(missing_ok=True)
    if importlib.util.find_spec("pip") is None:
        make_pip = subprocess.run([sys.executable, "-m", "ensurepip"], capture_output=True)
        if make_pip.returncode != 0:
            raise InstallError(
                ".venv has no pip: install Python's venv module (Debian: `apt-get install "
                "python3-venv`), run `make clean`, and try again."
            )

    settings: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = settings["project"]["optional-dependencies"]
    requirements: list[str] = settings["project"]["dependencies"]
    compiled = {r.split(">=")[0]: r for r in requirements if r.split(">=")[0] in COMPILED}

    install_torch(next(lower_bound(r) for r in requirements if r.startswith("torch>")))
    pins = VENV / "fluidsnet-constraints.txt"
    pins.write_text(f"torch=={importlib.metadata.version('torch')}\n")
    constraints = ["-c", str(pins)]

    others = [r for r in requirements if r not in compiled.values()]
    build_tools = [*settings["build-system"]["requires"], "wheel", "ninja"]
    pip_install("installing packages", *constraints, *build_tools, *others, *extras["dev"])

    wheels = compiled_wheels({name: lower_bound(r) for name, r in compiled.items()})
    # By path, so that no other wheel of the same version, for another torch, is taken; by force,
    # since the one that is installed may be for another torch.
    anew = ["--no-index", "--no-deps", "--force-reinstall"]
    pip_install("installing torch-scatter and torch-cluster", *anew, *map(str, wheels))
    program = "import torch, torch_scatter, torch_cluster"
    if subprocess.run([sys.executable, "-c", program]).returncode != 0:
        raise InstallError(
            "torch-scatter or torch-cluster does not fit torch, as shown above: remove "
            f"{wheels[0].parent} and run this again."
        )

    pip_install("installing FluidsNet", "--no-deps", "--no-build-isolation", "-e", ".")
    install_solver(extras["solver"][0], constraints)

    stamp = {"fingerprint": fingerprint(), "torch": os.environ.get("TORCH", "")}
    whole = STAMP.with_suffix(".new")
    whole.write_text(json.dumps(stamp))
    whole.replace(STAMP)
    say("FluidsNet is installed: .venv/bin/fluidsnet")


def stop(*_: object) -> NoReturn:
    """Turns a signal into an exception, so that what was started is ended as well."""
    for number in STOPPING:  # a second one, as make sends it, must not interrupt that
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def main() -> int:
    """Installs, or says in one sentence why not."""
    if sys.platform == "win32":
        print("error: FluidsNet installs on Linux and macOS; use WSL on Windows.", file=sys.stderr)
        return 1
    for number in STOPPING:
        signal.signal(number, stop)
    try:
        if Path(sys.prefix).resolve() != VENV.resolve():
            enter_venv()
        require_python()
        if not is_up_to_date():
            install()
    except InstallError as error:
        if error.details:
            print(error.details, file=sys.stderr)
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: the installation stopped: {error}.", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nstopped; what is whole is kept, the rest is done next time.", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
