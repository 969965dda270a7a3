# Two commands do all the set-up: make demo, make test. They need Python 3.11+ and make, nothing else.
# make test SHUFFLE=3 runs the tests in a random order with that seed; JOBS=1 in one process. By default there is one
# process more than cores, up to four, as tests wait for other processes now and then.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
JOBS ?= $(shell expr $$(getconf _NPROCESSORS_ONLN) + 1)
PYTEST = $(BIN)/python -m pytest --numprocesses $(JOBS) --maxprocesses 4 --dist worksteal \
	$(if $(SHUFFLE),-p randomly --randomly-seed=$(SHUFFLE)) $(if $(REPORTS),--junitxml=$(REPORTS)/$@.xml)
export PIP_DISABLE_PIP_VERSION_CHECK = 1
# Tests start many processes: none compiles the sources to bytecode again, whatever the environment says.
export PYTHONDONTWRITEBYTECODE =

.PHONY: demo kernels test long test-all kernels-checked check lint-release docs bench attack wheel wheels sdist format clean
.DELETE_ON_ERROR:

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable '.[jit]'
	@touch $@

$(VENV)/tools: pyproject.toml $(VENV)/installed
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $@

$(VENV)/wheel: pyproject.toml $(VENV)/tools
	$(BIN)/python -m pip install --quiet --editable '.[wheel]'
	@touch $@

$(VENV)/release: pyproject.toml $(VENV)/tools
	$(BIN)/python -m pip install --quiet --editable '.[release]'
	@touch $@

demo: $(VENV)/installed
	$(BIN)/pointray demo -o demo.png

# All kernels as a native library for this processor, on all cores; what has not changed is kept.
kernels: $(VENV)/tools
	$(BIN)/python -m native

test: kernels
	$(PYTEST)

long: kernels
	$(PYTEST) -m long

test-all: test
	$(MAKE) long

# Every array access and SIMD load of kernels checked; the tests of rays build trees too.
kernels-checked: $(VENV)/tools
	POINTRAY_CHECK=1 $(BIN)/python -m pytest $(addprefix tests/unit/surface/,splats/test_cells.py intersect/test_gather.py \
		trace/test_trace.py)

check: $(VENV)/tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python .ci/phrases.py

# Workflows and their scripts, Dockerfile, conda recipe. Takes seconds.
lint-release: $(VENV)/release
	$(BIN)/jactionlint --profile correctness --shellcheck=$(BIN)/shellcheck
	$(BIN)/shellcheck .ci/run
	$(BIN)/hadolint packaging/Dockerfile
	$(BIN)/python .ci/lint_recipe.py packaging/conda/recipe.yaml

$(VENV)/docs: pyproject.toml $(VENV)/installed
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@

# The documentation site, in build/docs/html: runs the code of all pages, compares their pictures, calls Sphinx.
# make docs ACCEPT=1 stores the pictures that pages produce; make docs ONLY=guides runs the pages of that name.
docs: $(VENV)/docs
	$(BIN)/python -m docs.site $(if $(ACCEPT),--accept) $(if $(ONLY),--only $(ONLY) --pages)

format: $(VENV)/tools
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/tools
	$(BIN)/python -m bench.tracing.embree

# 220,000 inputs in about an hour; interrupted, it goes on when called again, until src/, tests/helpers/ or
# tests/robustness/attack/ is changed.
# One part: make attack PART=ply COUNT=1000 SEED=3; one input: make attack PART=ply SEED=3 INPUT=17.
attack: $(VENV)/tools
	PYTHONPATH=tests:tests/robustness $(BIN)/python -m attack $(PART) $(if $(SEED),--seed $(SEED)) $(if $(COUNT),--count $(COUNT)) $(if $(INPUT),--input $(INPUT))

SYSTEM ?= linux-x86_64

# With the kernels of all levels of processors, or of some: LEVELS="x86-64-v2 best". SYSTEM=macos-arm64 is for another
# system.
wheel: $(VENV)/wheel
	$(BIN)/python -m native --system $(SYSTEM) --zig $(addprefix --level ,$(LEVELS)) --out build/wheel/$(SYSTEM)
	POINTRAY_WHEEL=$(SYSTEM) $(BIN)/python -m build --wheel --outdir dist
	case $(SYSTEM) in linux-*) \
		$(BIN)/auditwheel show dist/*-manylinux_2_17_$(SYSTEM:linux-%=%).whl | grep '"manylinux_2_17_' ;; \
	esac
	$(BIN)/twine check --strict dist/*.whl
	$(BIN)/check-wheel-contents dist/*.whl

wheels:
	for system in linux-x86_64 linux-aarch64 windows-x86_64 macos-arm64 macos-x86_64; do \
		$(MAKE) wheel SYSTEM=$$system || exit 1; \
	done

OUT ?= dist

# The sources, and from them a wheel without libraries.
sdist: $(VENV)/wheel
	$(BIN)/python -m build --outdir $(OUT)
	$(BIN)/twine check --strict $(OUT)/*.tar.gz $(OUT)/*-any.whl
	$(BIN)/check-wheel-contents $(OUT)/*-any.whl

clean:
	rm -rf $(VENV) dist build
