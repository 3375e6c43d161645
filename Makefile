# `make demo` and `make test` are all that a fresh machine needs; both make .venv/ first.
PYTHON ?= python3
BIN := .venv/bin
EXTRAS := dev,docs,recon,viewer,colmap,phone,lidar,logs,usd,ray,slurm,mcp,app,train,warp,rsl-rl
# MuJoCo renders without a display.
export MUJOCO_GL ?= osmesa

.PHONY: demo test lint format venv bench readme docs wheel clean

demo: venv
	$(BIN)/realsim demo --out demo_out --overwrite

test: venv
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

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
	bash tools/check_wheel.sh $(BIN)/python

venv: .venv/.stamp

.venv/.stamp: pyproject.toml constraints.txt tools/system_packages.sh
	bash tools/system_packages.sh
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.11 ...")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[$(EXTRAS)]'
	touch $@

clean:
	rm -rf .venv demo_out build dist site *.egg-info
