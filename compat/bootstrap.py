"""Set up `.venv`: wheels, interface packages, this package, compiled functions. Run by `make`, safe to repeat.

    python3 compat/bootstrap.py [runtime|test|evaluation|viewer ...]

Needs python3 3.11, 3.12 or 3.13 with the venv module, a C and a C++ compiler. Each step leaves a stamp with a
digest of what it was made from, so a second call does only what has changed.
"""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / ".venv"
STATE = VENV / "set-up"
PYTHON = VENV / "bin" / "python"
# The first that is there is taken: from 3.13 on one wheel, kiss_matcher, is missing.
SUPPORTED = ((3, 12), (3, 11), (3, 13))
INTERFACE_PACKAGES = (
    "whereabouts_msgs",
    "compat/vision_msgs",
    "compat/tf2_msgs",
    "compat/map_msgs",
    "compat/nav2_msgs",
)
# Their functions are compiled to machine code, which is kept beside the sources.
COMPILED = ("estimation", "registration", "loop_closure", "tracking", "world_model")
VERSION_QUERY = "import sys; print('%d.%d' % sys.version_info[:2])"


# How much of a whole set-up each step is, for the share and the estimate that are shown; what is not named is little.
SHARES = {"requirements": 10, "whereabouts_msgs": 15, "compat/": 5, "package": 2, "compiled functions": 50}
EVERY = 15.0  # seconds between two lines while a step takes long
# What programs say when the fault is the machine's, and what to do: the last lines of a log rarely tell.
ADVICE = {
    "No space left on device": "the disk is full: make room; .venv takes more than 1 GB",
    "quota exceeded": "your share of the disk is used up: make room; .venv takes more than 1 GB",
    "Read-only file system": "nothing can be written to this folder: clone into another",
    "Permission denied": "something in this folder belongs to another user: clone into a folder of your own",
    "connection broken by": "the index of Python packages does not answer: look at the network, then try again",
}
# With these no other installer gets any further.
FINAL = ("No space left on device", "quota exceeded", "Read-only file system")
# Programs at work; each leads a session.
CHILDREN = set()


class Progress:
    """Says how far the set-up is, and how long it will take at the pace so far."""

    def __init__(self):
        self.started = time.monotonic()
        self.done = {}
        self.lock = threading.Lock()

    def plan(self, names):
        """Steps that are to come, with their shares."""
        for name in names:
            share = next((value for key, value in SHARES.items() if name.startswith(key)), 1)
            self.done[name] = (share, False)

    def finish(self, name):
        """A step is done."""
        with self.lock:
            self.done[name] = (self.done.get(name, (1, False))[0], True)

    def skip(self, name):
        """A step had nothing to do: it says nothing of the pace."""
        with self.lock:
            self.done.pop(name, None)

    def __str__(self):
        whole = sum(share for share, _ in self.done.values())
        part = sum(share for share, done in self.done.values() if done)
        if not whole or not part:
            return ""
        passed = time.monotonic() - self.started
        left = passed * (whole - part) / part
        return f" ({100 * part // whole} %, about {left:.0f} s left)" if part < whole else ""


PROGRESS = Progress()


class SetUpError(Exception):
    """Something the user has to install or decide; the message says what."""


def say(text):
    print("set-up: " + text, flush=True)


def find_interpreter():
    """The running Python if it is supported, else the first supported one from the PATH."""
    if sys.version_info[:2] in SUPPORTED and sys.prefix == sys.base_prefix:
        return sys.executable
    for major, minor in SUPPORTED:
        candidate = shutil.which(f"python{major}.{minor}")
        if candidate is None:
            continue
        # A version manager's shim may exist without an interpreter behind it.
        answer = subprocess.run([candidate, "-c", VERSION_QUERY], capture_output=True, text=True)
        if answer.stdout.strip() == f"{major}.{minor}":
            return candidate
    raise SetUpError(
        f"Python 3.11, 3.12 or 3.13 is needed, python3 is {sys.version.split()[0]}: install python3.12 and "
        "python3.12-venv "
        "(ROS 2 Jazzy's wheels exist for these only), or call `make PYTHON=/path/to/python3.12`."
    )


def check_compilers():
    """The generated message code is C and C++."""
    if not (os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")):
        raise SetUpError("a C compiler is missing: install it with `apt install build-essential`.")
    if not (os.environ.get("CXX") or shutil.which("c++") or shutil.which("g++")):
        raise SetUpError("a C++ compiler is missing: install it with `apt install build-essential`.")


def advice(text):
    """What to do about a failure that says this; empty if it does not tell."""
    return next((answer for sign, answer in ADVICE.items() if sign in text), "")


def run(command, log, env=None):
    """Run a command with its output in a log file; on failure show what to do, and the end of the log."""
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("w") as out:
        child = subprocess.Popen(
            [str(part) for part in command],
            stdout=out,
            stderr=subprocess.STDOUT,
            env=env,
            cwd=str(ROOT),
            start_new_session=True,
        )
        CHILDREN.add(child)
        code = child.wait()
        CHILDREN.discard(child)
    if code != 0:
        said = log.read_text(errors="replace")
        known = advice(said)
        tail = "\n".join(said.strip().splitlines()[-3 if known else -25 :])
        why = f"{known}.\n" if known else ""
        raise SetUpError(f"{why}{command[0]} failed, its last lines:\n{tail}\nAll of it is in {log}")


def end_children():
    """End all programs at work with whatever they have started, such as compilers, which may not heed Ctrl-C."""
    for child in list(CHILDREN):
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)


def interrupt(*_):
    """A set-up that is told to end, or whose terminal is closed, ends as by Ctrl-C."""
    raise KeyboardInterrupt


def clean_environment():
    """Environment for child processes: this virtual environment and no other Python or ROS installation."""
    env = dict(os.environ)
    for name in list(env):
        if name in ("PYTHONPATH", "PYTHONHOME", "CMAKE_PREFIX_PATH", "ROS_DISTRO"):
            del env[name]
    # Dozens of short Python processes import the same modules, which none of them should have to compile anew.
    env.pop("PYTHONDONTWRITEBYTECODE", None)
    env["VIRTUAL_ENV"] = str(VENV)
    env["LC_ALL"] = "C.UTF-8"  # ADVICE is by English messages
    # The wheels' start-up hook sets the guard and the library path; both would point into another environment.
    if env.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None):
        env.pop("LD_LIBRARY_PATH", None)
    env["AMENT_PREFIX_PATH"] = str(VENV)
    env["PATH"] = "{}{}{}".format(VENV / "bin", os.pathsep, env.get("PATH", ""))
    return env


def digest(paths):
    """One digest over names and contents of files; folders count with all files below them."""
    total = hashlib.sha256()
    for path in sorted(paths):
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in files:
            total.update(str(file.relative_to(ROOT)).encode())
            total.update(file.read_bytes())
    return total.hexdigest()


def step(name, sources, action, extra=""):
    """Run `action` unless its stamp says that it was done from the same sources; say how long it took."""
    stamp = STATE / (name.replace("/", "-") + ".stamp")
    wanted = digest(sources) + extra
    if stamp.exists() and stamp.read_text() == wanted:
        PROGRESS.skip(name)
        return
    started = time.monotonic()
    say(f"{name} ...")
    over = threading.Event()
    teller = threading.Thread(target=tell, args=(name, over), daemon=True)
    teller.start()
    try:
        action()
    finally:
        over.set()
    stamp.parent.mkdir(parents=True, exist_ok=True)
    stamp.write_text(wanted)
    PROGRESS.finish(name)
    say(f"{name} done in {time.monotonic() - started:.0f} s{PROGRESS}")


def tell(name, over):
    """Says now and then that a step is still at work; silence looks like a set-up that hangs."""
    started = time.monotonic()
    while not over.wait(EVERY):
        say(f"{name}: {time.monotonic() - started:.0f} s so far")


def create_environment():
    """Create `.venv`, or replace one that is broken or was made by another Python."""
    if (VENV / "pyvenv.cfg").exists() and PYTHON.exists():
        answer = subprocess.run(
            [str(PYTHON), "-c", VERSION_QUERY + "; import pip"],
            capture_output=True,
            text=True,
            env=clean_environment(),
        )
        if answer.returncode == 0 and answer.stdout.strip() in (
            f"{major}.{minor}" for major, minor in SUPPORTED
        ):
            return
        say("replacing .venv, which does not work or has an unsupported Python")
    interpreter = find_interpreter()
    say(f"creating .venv with {interpreter}")
    shutil.rmtree(str(VENV), ignore_errors=True)
    answer = subprocess.run([interpreter, "-m", "venv", str(VENV)], capture_output=True, text=True)
    if answer.returncode != 0:
        shutil.rmtree(str(VENV), ignore_errors=True)
        said = (answer.stdout + answer.stderr).strip()
        missing = "Python's venv module is missing or incomplete: install it with `apt install python3-venv`"
        raise SetUpError(f"{advice(said) or missing}.\n{said}")


def requirement_files(name):
    """A requirements file and all that it includes."""
    path = ROOT / "requirements" / (name + ".txt")
    if not path.exists():
        known = ", ".join(sorted(p.stem for p in (ROOT / "requirements").glob("*.txt")))
        raise SetUpError(f"no requirements named {name}; there are: {known}")
    files = [path]
    for line in path.read_text().splitlines():
        if line.startswith("-r "):
            files += requirement_files(Path(line[3:].strip()).stem)
    return files


def install_requirements(name):
    """All packages of a requirements file, also after an installation that was interrupted."""
    begun = STATE / "installation-begun"
    # What was being written then passes for installed, and lacks files.
    anew = begun.exists()
    begun.parent.mkdir(parents=True, exist_ok=True)
    begun.touch()
    install_packages(name, anew)
    begun.unlink()


def install_packages(name, anew):
    """With uv in a fraction of pip's time; with pip where that has an index of its own, which uv does not ask."""
    log, env = STATE / (f"requirements-{name}.log"), clean_environment()
    # Python compiles what is imported; most files never are.
    pip = [PYTHON, "-m", "pip", "install", "--disable-pip-version-check", "--no-compile"]
    pip += ["--ignore-installed"] * anew
    if not own_index(env):
        try:
            run([*pip, "-r", "requirements/locking.txt"], log, env)
            uv = [VENV / "bin" / "uv", "pip", "install", *["--reinstall"] * anew, "-r"]
            run([*uv, f"requirements/{name}.txt"], STATE / (f"requirements-{name}-uv.log"), env)
            return
        except SetUpError as error:
            if any(ADVICE[sign] in str(error) for sign in FINAL):
                raise
            say(f"requirements-{name}: uv failed, pip takes over")
    run([*pip, "-r", f"requirements/{name}.txt"], log, env)


def own_index(env):
    """Whether pip is told to install from elsewhere than PyPI."""
    told = subprocess.run(
        [str(PYTHON), "-m", "pip", "config", "list"], env=env, stdout=subprocess.PIPE, text=True
    ).stdout
    return any(line.split("=")[0].endswith(".index-url") for line in told.splitlines())


def build_interfaces(folder):
    """Build one rosidl package with CMake into the environment, which is a merged ROS prefix."""
    name = Path(folder).name
    build = STATE / "build" / name
    shutil.rmtree(str(build), ignore_errors=True)
    env = clean_environment()
    # The wheels' start-up hook would start each Python a second time, for libraries that no generator loads.
    env["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
    env["PYTHONPATH"] = str(ROOT / "compat" / "generators")
    cmake = VENV / "bin" / "cmake"
    configure = [
        cmake, "-S", ROOT / folder, "-B", build, "-G", "Ninja", "-Wno-dev",
        "-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF", "-DCMAKE_INSTALL_RPATH=$ORIGIN",
        # Of the type support nearly all is headers: more takes half as long again and makes no message faster.
        "-DCMAKE_C_FLAGS_RELEASE=-O1 -DNDEBUG",
        "-DCMAKE_CXX_FLAGS_RELEASE=-O1 -DNDEBUG",
        f"-DCMAKE_INSTALL_PREFIX={VENV}", f"-DPython3_EXECUTABLE={PYTHON}",
        "-DCMAKE_PROJECT_INCLUDE=%s" % (ROOT / "compat" / "ros_wheels.cmake"),
    ]  # fmt: skip
    run(configure, STATE / (f"{name}-configure.log"), env)
    check_origin(build / "CMakeCache.txt")
    run([cmake, "--build", build, "--target", "install"], STATE / (f"{name}-build.log"), env)
    shutil.rmtree(str(build), ignore_errors=True)


def check_origin(cache):
    """A wheel that is missing would silently be replaced by a ROS package found under /usr or /opt/ros."""
    for line in cache.read_text().splitlines():
        name, _, value = line.partition("=")
        if name.endswith("_DIR:PATH") and value.startswith("/") and not value.startswith(str(VENV)):
            raise SetUpError("{} was found outside .venv, at {}".format(name.split(":")[0], value))


def install_package():
    command = [
        PYTHON, "-m", "pip", "install", "--disable-pip-version-check",
        "--no-deps", "--no-build-isolation", "--editable", ".", "--editable", "./evaluation",
    ]  # fmt: skip
    run(command, STATE / "package.log", clean_environment())


def compile_functions():
    run([PYTHON, "-m", "whereabouts.compile"], STATE / "compile.log", clean_environment())


def set_up(names):
    """All steps, in order; those that are done are left out."""
    check_compilers()
    PROGRESS.plan(
        [*("requirements-" + name for name in names), *INTERFACE_PACKAGES, "package", "compiled functions"]
    )
    create_environment()
    for name in names:
        step("requirements-" + name, requirement_files(name), lambda name=name: install_requirements(name))
    libraries = [path for name in COMPILED for path in (ROOT / name).rglob("*.py")]
    build_files = [
        ROOT / name
        for name in (
            "compat/generators/sitecustomize.py",
            "compat/ros_wheels.cmake",
            "requirements/build.txt",
        )
    ]
    package_files = [
        ROOT / name
        for name in (
            "setup.py",
            "setup.cfg",
            "package.xml",
            "evaluation/pyproject.toml",
            "evaluation/setup.py",
        )
    ]
    # Compiling runs beside the builds, which run mostly on one core, and needs nothing of them.
    compiling = ThreadPoolExecutor(max_workers=1).submit(
        step, "compiled functions", libraries, compile_functions
    )
    for folder in INTERFACE_PACKAGES:
        step(folder, [*build_files, ROOT / folder], lambda folder=folder: build_interfaces(folder))
    step("package", package_files, install_package, extra=str(ROOT))
    compiling.result()


def main(names):
    started = time.monotonic()
    try:
        set_up(names)
    except SetUpError as error:
        say(f"stopped: {error}")
        return 1
    except OSError as error:
        say(f"stopped: {advice(str(error)) or 'a file cannot be used'}.\n{error}")
        return 1
    except KeyboardInterrupt:
        say("interrupted: what is done is kept; the same command goes on from here")
        return 130
    finally:
        # What runs beside a step that failed would hold the end of the set-up up for minutes.
        end_children()
    if time.monotonic() - started > 5.0:
        say("ready after %.0f s" % (time.monotonic() - started))
    return 0


if __name__ == "__main__":
    for number in (signal.SIGTERM, signal.SIGHUP):
        # Under nohup it stays ignored.
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, interrupt)
    sys.exit(main(sys.argv[1:] or ["runtime"]))
