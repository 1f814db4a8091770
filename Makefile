# Two commands: `make demo` and `make test`. Each does all set-up by itself and is quick the second time.

PY := .venv/bin/python
RUN := runs/splash

# Open MPI refuses root and more ranks than cores unless told; single-copy transfers fail inside many containers.
export OMPI_ALLOW_RUN_AS_ROOT = 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM = 1
export OMPI_MCA_rmaps_base_oversubscribe = 1
export OMPI_MCA_btl_vader_single_copy_mechanism = none
# Images of containers often forbid Python to keep what it has compiled; each of the thousands of processes of the
# tests, each rank, would then compile 380 modules anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo test check gallery campaigns lint validate docs site matrix clean

help:
	@echo "make demo      set-up, a simulation on 2 ranks, its video"
	@echo "make test      set-up, ruff, mypy, and the tests that stand for all: half an hour on two cores"
	@echo "make check     the tests that make test leaves out: tests/long_tests.txt"
	@echo "make gallery   the showcases on 2 ranks, their videos and docs/gallery.md: an hour"
	@echo "make campaigns kills, full disks, damaged files and odd inputs in large numbers: minutes"
	@echo "make validate  the long tests; rewrites docs/benchmarks/validation.md"
	@echo "make lint      ruff and mypy only"
	@echo "make docs      rewrite the generated pages of docs/reference from the code"
	@echo "make site      the pages as a site, in site/"
	@echo "make matrix    the unit tests on every Python from 3.11 to 3.13 that is on the path"

setup:
	@./setup.sh

# without the parallel h5py, which takes two minutes to build: rank 0 writes the same bytes
demo:
	@EXTRAS= HDF5=serial ./setup.sh
	$(PY) runs/assets/make_assets.py
	$(PY) -m vgmpi $(RUN)/scene.toml --ranks 2 --overwrite --calibrate
	$(PY) -m vgmpi render $(RUN)/out $(RUN)/render.toml -o $(RUN)/out/video.mp4
	@echo
	@echo "video:    $(CURDIR)/$(RUN)/out/video.mp4"
	@echo "frames:   $(CURDIR)/$(RUN)/out/frames/"
	@echo "ParaView: $(CURDIR)/$(RUN)/out/series.vtkhdf"

gallery: setup
	$(PY) runs/gallery.py --variants

PYTEST := $(PY) -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder -m "not slow"

# all but those of tests/long_tests.txt, which check runs: both together run every test once that is not slow.
# Where their time goes: .venv/bin/python -m tests.benchmarks test-times .cache/tests.xml .cache/check.xml
# Two tests at a time share the cores: ranks that wait for others leave them to who computes.
test check: export OMPI_MCA_mpi_yield_when_idle = 1
test: setup lint
	$(PYTEST) --part quick --junitxml .cache/tests.xml

check: setup
	$(PYTEST) --part rest --junitxml .cache/check.xml

# fewer or others: .venv/bin/python -m tests.campaigns kills --count 10 --seed 7
campaigns: setup
	$(PY) -m tests.campaigns

validate: setup
	$(PY) -m tests.benchmarks.validation
	$(PY) -m pytest -m slow --ignore=tests/physics

lint: setup
	$(PY) -m ruff check
	$(PY) -m ruff format --check
	.venv/bin/lint-imports --no-logo
	$(PY) -m mypy

docs: setup
	$(PY) -m vgmpi.scene > docs/reference/scene.md
	$(PY) -m vgmpi.io.layout_reference > docs/reference/file-format.md
	$(PY) -m vgmpi.commands.command_reference > docs/reference/commands.md

site: docs
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict

# each in an environment of its own, on one rank: make matrix TESTS=tests/materials/test_sand.py for less
TESTS := $(addprefix tests/,docs gaussians io kernels materials planning preprocess runtime scene solver)
matrix:
	@export PYENV_VERSION=$$(pyenv versions --bare 2>/dev/null | paste -sd:); \
	for v in 3.11 3.12 3.13; do \
	  python$$v -c "" 2>/dev/null || { echo "python$$v: not here"; continue; }; \
	  echo "python$$v"; env=.cache/matrix/$$v; \
	  python$$v -m venv $$env && $$env/bin/pip --disable-pip-version-check install -q -e ".[test]" && \
	  $$env/bin/python -m pytest -q $(TESTS) -m "not mpi and not slow" || exit 1; \
	done

clean:
	rm -rf runs/*/out runs/photo/made site .cache/matrix .pytest_cache .ruff_cache .mypy_cache .hypothesis
