# `make demo` and `make test` are all that a fresh machine needs; they make .venv/ first, with what each needs.
PYTHON ?= python3
BIN := .venv/bin
INSTALL := bash tools/install.sh $(BIN)/python --constraint constraints.txt --editable
EXTRAS := dev,docs,recon,viewer,colmap,phone,lidar,logs,usd,ray,slurm,mcp,app,train,warp,rsl-rl
# Directories whose tests take a second or less each: what `make check` runs beside the linters.
QUICK := tests/core tests/cli tests/scale tests/align tests/robots tests/report tests/test_imports.py
# MuJoCo renders without a display.
export MUJOCO_GL ?= osmesa
# Memory of large arrays that is given back has to be cleared page by page when the next one is made.
export MALLOC_TRIM_THRESHOLD_ ?= 1000000000
export MALLOC_MMAP_THRESHOLD_ ?= 33554432
# What is compiled is kept, or each process of the tests compiles it again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo check test lint format venv bench readme docs wheel clean

demo: .venv/.demo
	$(BIN)/realsim demo --out demo_out --overwrite

check: lint
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow" $(QUICK)

test: venv
	$(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

lint: venv
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: venv
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: venv
	$(BIN)/python benchmarks/scenes/reconstruct.py

readme: venv
	$(BIN)/python -m benchmarks.tables

docs: venv
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

wheel: venv
	bash tools/check_wheel.sh

venv: .venv/.stamp

.venv/.made: tools/system_packages.sh
	bash tools/system_packages.sh
	$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14) and "Python 3.11 to 3.13 is needed: make PYTHON=python3.11 ...")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	-$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt uv
	touch $@

# The demo needs neither torch nor ray: 2.1 GB instead of 4.6.
.venv/.demo: pyproject.toml constraints.txt .venv/.made
	@echo "installing what the demo needs into .venv (once)"
	test -e .venv/.stamp || $(INSTALL) '.[recon]'
	touch $@

.venv/.stamp: pyproject.toml constraints.txt .venv/.made
	@echo "installing all parts into .venv (once)"
	$(INSTALL) '.[$(EXTRAS)]'
	touch $@

clean:
	rm -rf .venv demo_out build dist site *.egg-info
