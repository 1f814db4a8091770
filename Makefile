# Two commands: `make demo` and `make test`. Each does all set-up by itself and is quick the second time.

PY := .venv/bin/python
RUN := runs/splash

# Open MPI refuses root and more ranks than cores unless told; single-copy transfers fail inside many containers.
export OMPI_ALLOW_RUN_AS_ROOT = 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM = 1
export OMPI_MCA_rmaps_base_oversubscribe = 1
export OMPI_MCA_btl_vader_single_copy_mechanism = none

.PHONY: help setup demo test lint validate docs clean

help:
	@echo "make demo      set-up, a simulation on 2 ranks, its video"
	@echo "make test      set-up, then all tests but the long ones"
	@echo "make validate  the long tests; rewrites docs/validation.md"
	@echo "make lint      ruff and mypy only"
	@echo "make docs      rewrite docs/file-format.md from the code"

setup:
	@./setup.sh

demo: setup
	$(PY) runs/assets/make_assets.py
	mpirun -n 2 $(PY) -m vgmpi $(RUN)/scene.toml
	$(PY) -m postprocess.render $(RUN)/out $(RUN)/render.toml -o $(RUN)/out/video.mp4
	@echo
	@echo "video:    $(CURDIR)/$(RUN)/out/video.mp4"
	@echo "frames:   $(CURDIR)/$(RUN)/out/frames/"
	@echo "ParaView: $(CURDIR)/$(RUN)/out/series.vtkhdf"

test: setup lint
	$(PY) -m pytest -n auto --maxprocesses 4 --dist loadfile -m "not slow and not mpi"
	$(PY) -m pytest -m "not slow and mpi"

validate: setup
	$(PY) -m tests.validation
	$(PY) -m pytest -m slow --ignore=tests/physics

lint: setup
	$(PY) -m ruff check
	$(PY) -m ruff format --check
	$(PY) -m mypy

docs: setup
	$(PY) -m vgmpi.output.layout > docs/file-format.md

clean:
	rm -rf runs/*/out .pytest_cache .ruff_cache .mypy_cache .hypothesis
