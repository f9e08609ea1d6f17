"""Builds the native modules of torchrender: the same C++ sources once per instruction set.

Each instruction set becomes a library of its own (``torchrender/_core_v2.so``, ``_core_avx2.so``, ``_core_avx512.so``),
which computes in packets of single precision, with its own objects and hidden symbols, because templates compiled with
different flags into one library would be merged by the linker, and AVX-512 code could end up in the baseline. One more,
``_core_scalar.so``, computes without packets: in double precision, and on processors other than x86-64 in single, too.
``torchrender.backends`` loads the best one that the processor can run.

They have a C interface, which Python calls by ctypes: no header of Python is needed, and what is built serves all its
versions.

Ninja drives the compiler: only what changed is compiled again, in parallel. Nothing of torch is needed here.

Commands
    python setup.py build_ext --inplace     the modules, next to the Python sources (what ``make build`` runs)
    python setup.py native_tests            the C++ test program (``--sanitize``: with address and undefined-behaviour
                                            sanitizers), printed as a path
    python setup.py compile_kernels         kernels of common scenes for cards, into torchrender/_packs (``make cuda``):
                                            minutes, with NVRTC and all that torchrender needs, but no card
    python setup.py check_tools             only says whether everything that a build needs is there

Environment
    CXX, CXXFLAGS, LDFLAGS     the compiler (may hold arguments, "ccache g++"; default: a recent clang++ if there is
                               one, but for AVX-512 and sanitizers g++) and further flags
    MAX_JOBS                   number of compilers at once (default: number of processors)
    TORCHRENDER_BUILD_ISA      comma-separated list of instruction sets, to build less: "native" is the best one of
                               this machine's processor, which is what the Makefile asks for (scalar, which has
                               double precision, is built always)
    TORCHRENDER_MACHINE        the processor that a cross compiler compiles for, such as aarch64 (default: this one)
    TORCHRENDER_PORTABLE=1     on Linux: modules that run with older C libraries than this machine's, for wheels
    TORCHRENDER_CUDA           1, or compute capabilities of cards ("80 90"): what is installed has kernels of common
                               scenes for them; it needs NVRTC, and in the environment of the build what torchrender
                               needs (pip install --no-build-isolation .)
    TORCHRENDER_SANITIZE=1     build the modules with sanitizers (run Python with the sanitizer's library preloaded)
"""

from __future__ import annotations

import contextlib
import filecmp
import functools
import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

from setuptools import Command, Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).resolve().parent
CSRC = ROOT / "csrc"
PRECOMPILED = CSRC / "precompiled.h"

# The levels x86-64-v2, -v3 and -v4 flag by flag: compilers older than GCC 11 or clang 12 do not know the names.
V2_FLAGS = ["-msse4.2", "-mpopcnt", "-mcx16", "-msahf"]
AVX2_FLAGS = [*V2_FLAGS, "-mavx2", "-mfma", "-mf16c", "-mbmi", "-mbmi2", "-mlzcnt", "-mmovbe"]
AVX512_FLAGS = [
    *AVX2_FLAGS,
    *["-mavx512f", "-mavx512bw", "-mavx512cd", "-mavx512dq", "-mavx512vl", "-mprefer-vector-width=512"],
]
# What is compiled for: TORCHRENDER_MACHINE of a cross compiler.
IS_X86 = os.environ.get("TORCHRENDER_MACHINE", platform.machine()).lower() in ("x86_64", "amd64")
ISA_FLAGS = {"scalar": []} | ({"v2": V2_FLAGS, "avx2": AVX2_FLAGS, "avx512": AVX512_FLAGS} if IS_X86 else {})
PACKET_ISAS = ["v2", "avx2", "avx512"] if IS_X86 else []
# What Linux calls the flags that tell a processor which can run them.
CPU_FLAGS = {"avx2": frozenset("avx2 fma f16c bmi1 bmi2 abm movbe".split())}
CPU_FLAGS["avx512"] = CPU_FLAGS["avx2"] | frozenset("avx512f avx512bw avx512cd avx512dq avx512vl".split())
PACKET_WIDTH = {"scalar": 1, "v2": 4, "avx2": 8, "avx512": 16}  # floats in a register

# What renders on devices, and runs kernels on cards: it calls the renderer for plain numbers, which that module alone
# has.
OF_NUMBERS = ("device_boundary", "device_boundary_paths", "device_derivative", "device_film", "device_light")
OF_NUMBERS += ("device_outlines", "device_outputs", "device_paths", "device_scene", "device_tape", "device_tile")
OF_NUMBERS += ("scene_facts",)
ON_CARDS = ("cards", "compiler", "compiling_launcher", "cuda_launcher", "kernel_cache", "sha256")

# What the native tests do not call, and what that alone needs: a fifth of their compilation.
NOT_TESTED = ("render_aovs", "render_response", "upsampling")
OF_OUTPUTS = ("aovs", "bsdf_aovs", "outputs")  # which are tested on devices

# From this version on clang comes before GCC 12: packets are compiled in 0.63 of the time and run in 0.9 to 0.95 of it.
RECENT_CLANG = 14

STILL = 30  # seconds after which a build that writes to no terminal says that it goes on

SANITIZE_FLAGS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer", "-g1"]


def fail(sentence: str) -> None:
    """Stop the build with one sentence instead of a traceback."""
    raise SystemExit(f"torchrender: {sentence}")


def native_isas() -> list[str]:
    """The best instruction set of this processor; all of them where it cannot be asked."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return PACKET_ISAS
    line = next((line for line in text.splitlines() if line.startswith("flags")), "")
    flags = set(line.partition(":")[2].split())
    best = [isa for isa in PACKET_ISAS if CPU_FLAGS.get(isa, frozenset()) <= flags]
    return best[-1:]


def selected_isas() -> list[str]:
    """The instruction sets to build, best last: all of this processor unless TORCHRENDER_BUILD_ISA says otherwise."""
    wanted = [name.strip() for name in os.environ.get("TORCHRENDER_BUILD_ISA", "").split(",") if name.strip()]
    wanted = [name for word in wanted for name in (native_isas() if word == "native" else [word])]
    unknown = [name for name in wanted if name not in ISA_FLAGS]
    if unknown:
        fail(f"TORCHRENDER_BUILD_ISA names {unknown[0]!r}; this processor has {', '.join(ISA_FLAGS)}.")
    return [name for name in ISA_FLAGS if name == "scalar" or name in (wanted or PACKET_ISAS)]


# --- tools -----------------------------------------------------------------------------------------------------------


@functools.cache
def recent_clangs() -> list[str]:
    """Newest first. Debian's packages have a number in the name, and a plain `clang++` that may be older."""
    versions = {}
    for name in filter(shutil.which, ["clang++", *(f"clang++-{n}" for n in range(RECENT_CLANG, 50))]):
        with contextlib.suppress(OSError):  # what cannot be run
            done = subprocess.run([name, "-dumpversion"], capture_output=True, text=True)
            versions[name] = int((re.match(r"\d+", done.stdout) or ["0"])[0])
    return sorted((name for name in versions if versions[name] >= RECENT_CLANG), key=lambda name: -versions[name])


def find_compiler(isa: str, sanitize: bool = False) -> list[str]:
    """The C++ compiler as a command line: the best one that compiles a line of C++17 for an instruction set."""
    given = os.environ.get("CXX")
    # clang 19 comes to no end with a file for AVX-512; and its libraries of sanitizers are a package of their own.
    clangs = [] if isa == "avx512" or sanitize else recent_clangs()
    candidates = [given] if given else [*clangs, "g++", "clang++", "c++"]
    commands = [command for command in map(shlex.split, candidates) if shutil.which(command[0])]
    hint = "sudo apt install g++ (Debian, Ubuntu) or sudo dnf install gcc-c++ (Fedora)"
    if not commands:
        fail(f"there is no C++ compiler (looked for {', '.join(candidates)}); install one with: {hint}.")
    probe = "#include <optional>\nint main() { if constexpr (true) return std::optional<int>(0).value(); }\n"
    reasons = []
    for command in commands:
        probed = [*command, "-std=c++17", *ISA_FLAGS[isa], "-fsyntax-only", "-x", "c++", "-"]
        done = subprocess.run(probed, input=probe, capture_output=True, text=True)
        if done.returncode == 0:
            return command
        reason = (done.stderr.strip().splitlines() or ["no message"])[0]
        reasons.append(f"{shlex.join(command)} cannot compile C++17 for {isa} ({reason})")
    fail(f"{reasons[0]}; a newer compiler helps: {hint}.")
    raise AssertionError  # not reached


def switched_on(variable: str) -> bool:
    return os.environ.get(variable, "") not in ("", "0")


def library_path(command: list[str], name: str) -> str:
    """Where the compiler finds a library."""
    done = subprocess.run([*command, f"-print-file-name={name}"], capture_output=True, text=True)
    return done.stdout.strip()


def predefined_macros(command: list[str]) -> str:
    """What the compiler says of itself."""
    done = subprocess.run([*command, "-dM", "-E", "-x", "c++", "-"], input="", capture_output=True, text=True)
    return done.stdout


def flags_of(macros: str) -> list[str]:
    """What a compiler needs that calls itself so."""
    # Read by Ninja alone: what another version has compiled, which may have the same name, is compiled again.
    version = re.search(r'#define __VERSION__ "(.*)"', macros)
    flags = [f'-DTR_COMPILED_BY="{version[1]}"'] if version else []
    if "__clang__" in macros:
        return [*flags, "-Wno-deprecated-declarations"]  # libstdc++'s, which clang finds in precompiled headers
    flags += ["-fno-gnu-unique"]
    if IS_X86:
        # GCC fills and copies structures of 64 bytes to 8 KiB by `rep stos` and `rep movs`, which take tens of cycles
        # to begin, and what follows cannot be forwarded to loads; packets are full of such structures.
        by_vectors = "vector_loop:8192:noalign,libcall:-1:noalign"
        flags += [f"-mmemset-strategy={by_vectors}", f"-mmemcpy-strategy={by_vectors}"]
    major = re.search(r"__GNUC__ (\d+)", macros)
    if major and int(major[1]) >= 11:
        # GCC 12 takes a function for one that does not read what it is given by reference, if all that it does is to
        # hand it on by value, and drops what was written there for it (as in csrc/tests/test_device_paths.cpp).
        flags.append("-fno-ipa-modref")
    return flags


def package_include(package: str) -> str:
    """The ``include`` directory inside an installed build requirement, found without importing the package."""
    spec = importlib.util.find_spec(package)
    for place in (spec.submodule_search_locations or []) if spec else []:
        if os.path.isdir(os.path.join(place, "include")):
            return os.path.join(place, "include")
    fail(f"the headers of {package} are missing; install them with: {sys.executable} -m pip install {package}.")
    raise AssertionError  # not reached


def find_ninja() -> list[str]:
    """Ninja as a command line: the wheel of the build requirements, else a program of that name."""
    if importlib.util.find_spec("ninja"):
        return [sys.executable, "-m", "ninja"]
    found = shutil.which("ninja")
    if not found:
        fail(f"ninja is missing; install it with: {sys.executable} -m pip install ninja.")
    return [str(found)]


# --- the build description -------------------------------------------------------------------------------------------


def library_sources() -> list[Path]:
    """Everything but the bindings, the device kernels, the tests and what only wheels have."""
    skip = {"bindings", "cuda", "portable", "tests"}
    return sorted(p for p in CSRC.rglob("*.cpp") if p.relative_to(CSRC).parts[0] not in skip)


def binding_sources() -> list[Path]:
    return sorted((CSRC / "bindings").rglob("*.cpp"))


def compile_flags(isa: str, sanitize: bool) -> list[str]:
    # No fast-math: NaN and infinity keep their meaning. errno and floating-point traps are used nowhere, and giving
    # them up lets the compiler vectorise square roots and selections.
    flags = ["-std=c++17", "-fPIC", "-fvisibility=hidden", "-fvisibility-inlines-hidden", "-pthread"]
    flags += ["-fno-math-errno", "-fno-trapping-math", "-Wall", "-Wextra", f"-I{CSRC}"]
    # Dr.Jit's packets read single lanes through pointers of another type; without this, optimised code reads garbage.
    flags += ["-fno-strict-aliasing"]
    # How vectors are passed to functions does not matter: none are between files with flags of their own.
    flags += ["-Wno-psabi"]
    # -isystem: warnings of other people's headers are not ours to fix.
    flags += ["-isystem", package_include("drjit")]
    # Beside packets, plain numbers are there for checking: as fast, and compiled in two thirds of the time of -O2.
    optimized = "-O1" if isa == "scalar" and IS_X86 else "-O3"
    flags += ["-O1", *SANITIZE_FLAGS] if sanitize else [optimized, "-DNDEBUG", "-g0"]
    flags += [*ISA_FLAGS[isa], f"-DTR_ISA={isa}", f'-DTR_ISA_NAME="{isa}"', f"-DTR_PACKET_WIDTH={PACKET_WIDTH[isa]}"]
    if isa == "avx512":
        # GCC 12 warns about its own intrinsics' deliberately undefined registers (GCC bug 105593).
        flags += ["-Wno-uninitialized"]
    return flags + shlex.split(os.environ.get("CXXFLAGS", ""))


def escape(text: str) -> str:
    return text.replace("$", "$$").replace(" ", "$ ").replace(":", "$:")


class Compiler:
    """That of an instruction set: its command line, and the flags that it needs."""

    def __init__(self, isa: str, sanitize: bool) -> None:
        self.command = find_compiler(isa, sanitize)
        macros = predefined_macros(self.command)
        self.flags, self.is_clang = flags_of(macros), "__clang__" in macros


class Ninja:
    """Collects build edges, writes ``build.ninja`` and runs it. Objects lie in a folder an instruction set."""

    def __init__(self, directory: Path, isas: list[str], sanitize: bool) -> None:
        self.directory = directory
        self.compilers = {isa: Compiler(isa, sanitize) for isa in isas}
        self.lines = [
            "ninja_required_version = 1.5",
            "rule compile",
            "  command = $cxx -MMD -MF $out.d $flags -c $in -o $out",
            "  depfile = $out.d",
            "  deps = gcc",
            "  description = compile $what",
            "rule link",
            "  command = $cxx $in -o $out $flags",
            "  description = link $what",
        ]
        self.targets: list[Path] = []
        self.headers: list[Path] = []

    def _edge(
        self, rule: str, isa: str, target: Path, inputs: list[Path], flags: list[str], implicit: list[Path]
    ) -> None:
        line = f"build {escape(str(target))}: {rule} " + " ".join(escape(str(p)) for p in inputs)
        if implicit:
            line += " | " + " ".join(escape(str(p)) for p in implicit)
        compiled = target.relative_to(self.directory).with_suffix("")
        what = f"{target.parent.name}/{target.name}" if rule == "link" else str(compiled)
        cxx, joined = (shlex.join(words).replace("$", "$$") for words in (self.compilers[isa].command, flags))
        self.lines += [line, f"  cxx = {cxx}", f"  flags = {joined}", f"  what = {what}"]

    def objects(self, sources: list[Path], isa: str, flags: list[str]) -> list[Path]:
        """Compile ``sources`` with ``flags`` into objects of an instruction set; returns the objects' paths."""
        compiler = self.compilers[isa]
        flags = [*flags, *compiler.flags]
        header, made = self.precompiled(isa, flags), []
        if header and compiler.is_clang:
            flags = ["-include-pch", str(header), *flags]
        elif header:
            # Found in the folder before the header of this name in csrc, which a compiler reads that cannot use it.
            flags = [f"-I{header.parent}", "-include", PRECOMPILED.name, *flags]
        for source in sources:
            target = self.directory / isa / source.relative_to(CSRC).with_suffix(".o")
            # The bindings hand rows and addresses on.
            own = ["-O1"] if source.parent.name == "bindings" else []
            # Rays go back over the very numbers that brought them there, and triangles share their edges' numbers: a
            # product and a sum must round alike wherever they are written.
            alike = ("bend", "bent_rays", "test_bend", "test_tree")
            on_devices = source.parent.name == "device" or source.stem.removeprefix("test_").startswith("device")
            own += ["-ffp-contract=off"] if source.stem in alike or on_devices else []
            self._edge("compile", isa, target, [source], flags + own, [header] if header else [])
            made.append(target)
        return made

    def precompiled(self, isa: str, flags: list[str]) -> Path | None:
        """What its sources have in front of them. Not for ccache, which by default keeps nothing then."""
        if any("ccache" in word for word in self.compilers[isa].command):
            return None
        header = self.directory / isa / f"{PRECOMPILED.name}.gch"
        if header not in self.headers:
            self._edge("compile", isa, header, [PRECOMPILED], [*flags, "-x", "c++-header"], [])
            self.headers.append(header)
        return header

    def link(
        self, isa: str, target: Path, objects: list[Path], flags: list[str], implicit: list[Path] | None = None
    ) -> None:
        self._edge("link", isa, target, objects, flags + shlex.split(os.environ.get("LDFLAGS", "")), implicit or [])
        self.targets.append(target)

    def run(self) -> None:
        self.directory.mkdir(parents=True, exist_ok=True)
        script = self.directory / "build.ninja"
        text = "\n".join(self.lines) + "\n"
        with locked(self.directory / "lock"):
            if not script.exists() or script.read_text() != text:
                script.write_text(text)
            jobs = os.environ.get("MAX_JOBS", "") or str(os.cpu_count() or 1)
            command = [*find_ninja(), "-f", script.name, "-j", jobs]
            if self.say_what_comes(command, jobs) and self.build(command) != 0:
                fail("the native modules could not be compiled; the compiler's messages stand above.")

    def say_what_comes(self, command: list[str], jobs: str) -> bool:
        """Say how much is to be compiled; whether there is anything to be done."""
        dry = subprocess.run([*command, "-n"], cwd=self.directory, capture_output=True, text=True)
        if dry.returncode == 0 and "no work to do" in dry.stdout:
            return False
        count = sum("] compile " in line for line in dry.stdout.splitlines())
        if count:
            files = "1 file" if count == 1 else f"{count} files, {min(int(jobs), count)} at a time"
            minutes = "; that takes some minutes" if count > 10 else ""
            print(f"torchrender: compiling {files}{minutes}", file=sys.stderr, flush=True)
        return True

    def build(self, command: list[str]) -> int:
        """Run Ninja, and where its progress is written line by line, in a pipe, say that a long file is going on."""
        # Progress goes to the error stream: standard output is for what a command is asked to print.
        with subprocess.Popen(command, cwd=self.directory, stdout=sys.stderr) as process:
            started, pause = time.monotonic(), None if sys.stderr.isatty() else STILL
            while True:
                try:
                    return process.wait(pause)
                except subprocess.TimeoutExpired:
                    passed = time.monotonic() - started
                    # in one write, between whose text and newline Ninja says nothing
                    sys.stderr.write(f"torchrender: still compiling, {passed:.0f} s so far\n")
                    sys.stderr.flush()


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Two builds in one checkout wait for each other."""
    with open(path, "w") as handle:
        try:
            import fcntl
        except ImportError:  # not on this operating system: builds are then simply not run side by side
            yield
            return
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def build_modules(directory: Path, isas: list[str], sanitize: bool) -> dict[str, Path]:
    """Compile and link one module per instruction set; returns their paths by instruction set."""
    if not binding_sources():
        fail(f"there are no native sources under {CSRC}; the checkout or source archive is incomplete.")
    ninja = Ninja(directory, isas, sanitize)
    # Only the C interface is visible. Without this, and with GCC's "unique" symbols, the dynamic linker may
    # let one module run a template instance (of the standard library, say) that was compiled for another's processor.
    exports = directory / "exports.map"
    directory.mkdir(parents=True, exist_ok=True)
    exports_text = "{ global: tr_*; local: *; };\n"
    if not exports.exists() or exports.read_text() != exports_text:
        exports.write_text(exports_text)
    is_mac = sys.platform == "darwin"
    products = {}
    of_numbers = [p for p in library_sources() if p.stem in (*OF_NUMBERS, *ON_CARDS)]
    sources = [p for p in library_sources() if p not in of_numbers]
    device = [p for p in sources if p.parent.name == "device"]
    library, shared = [p for p in sources if p not in device], []
    for isa in isas:
        flags = compile_flags(isa, sanitize)
        own = library + binding_sources() + (of_numbers if isa == "scalar" else [])
        objects = ninja.objects(own, isa, flags)
        # csrc/device has no packets: compiled once, for the first module, whose code every processor can run
        shared = shared or ninja.objects(device, isa, flags)
        objects += shared
        link = ["-dynamiclib"] if is_mac else ["-shared", f"-Wl,--version-script={exports}"]
        if switched_on("TORCHRENDER_PORTABLE") and sys.platform == "linux":
            objects += ninja.objects([CSRC / "portable" / "older_linux.cpp"], isa, flags)
            # libraries of their own before glibc 2.34, of which the linker makes a note only if they are named by path
            link += [
                "-Wl,--no-as-needed",
                *(library_path(ninja.compilers[isa].command, f"lib{name}") for name in ("dl.so.2", "pthread.so.0")),
            ]
        link += SANITIZE_FLAGS if sanitize else (["-Wl,-x"] if is_mac else ["-Wl,-s"])
        products[isa] = directory / f"_core_{isa}.so"
        ninja.link(isa, products[isa], objects, [*link, "-pthread", "-ldl"], [] if is_mac else [exports])
    ninja.run()
    return products


def build_native_tests(directory: Path, isa: str, sanitize: bool) -> Path:
    """Compile the renderer and csrc/tests, without Python, into one test program; returns its path."""
    sources = sorted((CSRC / "tests").rglob("*.cpp"))
    if not sources:
        fail(f"there are no native tests under {CSRC / 'tests'}.")
    ninja = Ninja(directory, [isa], sanitize)
    library = [p for p in library_sources() if p.stem not in NOT_TESTED]
    if isa != "scalar":
        library = [p for p in library if p.stem not in OF_NUMBERS + OF_OUTPUTS]
    # Sanitized code is compiled in half the time without optimising; nothing is timed here.
    flags = compile_flags(isa, sanitize) + (["-O0", "-Wno-maybe-uninitialized"] if sanitize else [])
    objects = ninja.objects(library + sources, isa, flags)
    program = directory / f"native_tests_{isa}"
    ninja.link(isa, program, objects, [*(SANITIZE_FLAGS if sanitize else []), "-pthread", "-ldl"])
    ninja.run()
    return program


# --- setuptools ------------------------------------------------------------------------------------------------------


def replace_file(source: Path, target: Path) -> None:
    """Copy by renaming: a program that has the old module loaded keeps running on the old file."""
    if target.exists() and filecmp.cmp(source, target, shallow=False):
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f"{target.name}.{os.getpid()}.new")
    shutil.copyfile(source, temporary)
    os.chmod(temporary, 0o755)
    os.replace(temporary, target)


def copy_kernels(target: Path) -> None:
    """What kernels for cards are compiled from when they are first used."""
    for name in ("core", "device"):
        shutil.copytree(CSRC / name, target / name, dirs_exist_ok=True)


# Cards that kernels are compiled for unless TORCHRENDER_CUDA says which; drivers of later ones compile PTX themselves.
CAPABILITIES = ["80", "86", "89", "90"]
COMMON_SCENES = ("cornell_box", "textured_sphere", "textured_monkey")


def compile_kernels(package: Path) -> None:
    """Kernels of common scenes, by the package in this folder and into it. TORCHRENDER_CUDA: capabilities, or 1."""
    given = os.environ.get("TORCHRENDER_CUDA", "1").replace(",", " ").split()
    capabilities = CAPABILITIES if given == ["1"] else given
    if not all(word.isdecimal() for word in capabilities):
        fail(f"TORCHRENDER_CUDA is {' '.join(given)}; expected 1 or capabilities of cards, such as '80 90'.")
    scenes = [str(ROOT / "scenes" / f"{name}.xml") for name in COMMON_SCENES]
    command = [sys.executable, "-m", "torchrender.cuda", "compile", *scenes, "--for", *capabilities]
    command += ["--ptx", min(capabilities, key=int), "--into", str(package / "_packs")]
    environment = {**os.environ, "PYTHONPATH": str(package.parent)}
    environment.pop("TORCHRENDER_KERNELS", None)
    done = subprocess.run(command, env=environment, cwd=package.parent, stderr=subprocess.PIPE, text=True)
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        hint = "; what torchrender needs has to be there: pip install --no-build-isolation ." * ("No module" in reason)
        fail(f"TORCHRENDER_CUDA: kernels cannot be compiled ({reason}){hint}")


class BuildModules(build_ext):
    """build_ext through Ninja. In a checkout objects are kept in build/native, else in setuptools' build folder."""

    def get_ext_filename(self, fullname: str) -> str:
        return f"{fullname.replace('.', '/')}.so"  # Python does not import it: no version in its name

    def run(self) -> None:
        if sys.platform == "win32":
            fail("Windows is not supported yet; the Windows Subsystem for Linux is.")
        sanitize = switched_on("TORCHRENDER_SANITIZE")
        base = ROOT / "build" / "native" if self.inplace else Path(self.build_temp).resolve()
        directory = base / (sysconfig.get_platform() + ("-sanitize" if sanitize else ""))
        products = build_modules(directory, selected_isas(), sanitize)
        for extension in self.extensions:
            product = products[extension.name.rsplit("_", 1)[1]]
            replace_file(product, Path(self.get_ext_fullpath(extension.name)))
        if not self.inplace:
            package = Path(self.build_lib).resolve() / "torchrender"
            copy_kernels(package / "_kernels")
            if switched_on("TORCHRENDER_CUDA"):
                compile_kernels(package)


class Wheel(bdist_wheel):
    """A wheel for one platform and every Python 3: its libraries know none."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


class NativeTests(Command):
    """Build the C++ test program and print its path."""

    description = "build the C++ test program"
    user_options: ClassVar = [
        ("sanitize", None, "with address and undefined-behaviour sanitizers"),
        ("isa=", None, "instruction set (default: the lowest that is built)"),
        ("folder=", None, "where its objects are kept, in build/native (default: tests, or tests-sanitize)"),
    ]
    boolean_options: ClassVar = ["sanitize"]

    def initialize_options(self) -> None:
        self.sanitize = False
        self.isa = self.folder = None

    def finalize_options(self) -> None:
        self.isa = self.isa or selected_isas()[0]
        if self.isa not in ISA_FLAGS:
            fail(f"--isa is {self.isa!r}; this processor has {', '.join(ISA_FLAGS)}.")

    def run(self) -> None:
        folder = self.folder or ("tests-sanitize" if self.sanitize else "tests")
        directory = ROOT / "build" / "native" / folder / self.isa
        print(build_native_tests(directory, self.isa, bool(self.sanitize)))


class WithoutOptions(Command):
    user_options: ClassVar = []

    def initialize_options(self) -> None:
        pass

    def finalize_options(self) -> None:
        pass


class CompileKernels(WithoutOptions):
    """Kernels for cards, of common scenes, into the package of a working copy."""

    description = "compile kernels of common scenes for cards (TORCHRENDER_CUDA)"

    def run(self) -> None:
        compile_kernels(ROOT / "torchrender")


class CheckTools(WithoutOptions):
    """Say in one sentence what a build lacks, before anything large is downloaded."""

    description = "check that compiler and build requirements are there"

    def run(self) -> None:
        for isa in selected_isas():
            find_compiler(isa)
        package_include("drjit")
        find_ninja()


setup(
    ext_modules=[Extension(f"torchrender._core_{isa}", sources=[]) for isa in selected_isas()],
    cmdclass={
        "build_ext": BuildModules,
        "bdist_wheel": Wheel,
        "native_tests": NativeTests,
        "compile_kernels": CompileKernels,
        "check_tools": CheckTools,
    },
)
